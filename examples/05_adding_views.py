"""A field that grows: built from some views, then given the others one by one, and asked in between.

    python examples/05_adding_views.py demo/scene demo/scene/text.npz teapot

Only new views are rasterised, and the codebook of the first field codes the regions of all. For a window of the newest
frames of a robot's camera, pass those cameras only: the sums of other views are ignored.
"""

import sys

import scoup

scene, words, thing = sys.argv[1:4]

gaussians = scoup.load_gaussians(scene)
cameras = scoup.load_cameras(scene)
regions = scoup.load_regions(scene, cameras)
half = max(1, len(cameras) // 2)

sums = scoup.region_sums(gaussians, cameras[:half], regions)
first = scoup.build(gaussians, cameras[:half], regions, words=words, sums=sums)
print(f"{half} views: {first.location(thing)}")
for count in range(half + 1, len(cameras) + 1):
    field = scoup.build(
        gaussians, cameras[:count], regions, words=words, sums=sums, codebook=first, check_fit=False
    )
    print(f"{count} views: {field.location(thing)}")
