"""A field that grows: built from some views, then given the others one by one, and asked in between.

    python examples/05_adding_views.py demo/scene demo/scene/text.npz teapot

Only new views are rasterised. The codebook stays, unless ``new_atoms`` adds some for what no earlier view showed.
"""

import sys

import scoup

scene, words, thing = sys.argv[1:4]

gaussians = scoup.load_gaussians(scene)
cameras = scoup.load_cameras(scene)
regions = scoup.load_regions(scene, cameras)
half = max(1, len(cameras) // 2)

sums = scoup.region_sums(gaussians, cameras[:half], regions)
field = scoup.build(gaussians, cameras[:half], regions, words=words, sums=sums)
print(f"{half} views: {field.location(thing)}")
for camera in cameras[half:]:
    field = scoup.update(field, sums, add=[camera], regions=regions, new_atoms=4)
    print(f"{len(sums)} views: {field.location(thing)}")
