"""Add views to a field: build it from some of them, add the others one by one, and ask in between.

    python examples/05_adding_views.py demo/scene demo/scene/text.npz teapot

Only new views are rasterised, and the codebook of an earlier field codes the regions of all, until it explains those of
a view badly: then a new one is learned. For a window of the newest frames of a robot's camera, pass those cameras only:
the sums of other views are ignored.
"""

import sys
import warnings

import scoup

if len(sys.argv) < 4:
    sys.exit(__doc__)
scene, words, thing = sys.argv[1:4]

gaussians = scoup.load_gaussians(scene)
cameras = scoup.load_cameras(scene)
regions = scoup.load_regions(scene, cameras)
half = max(1, len(cameras) // 2)

sources = scoup.FieldSources(words=words)
sums = scoup.region_sums(gaussians, cameras[:half], regions)
learned = scoup.build(gaussians, cameras[:half], regions, sources=sources, sums=sums)
print(f"{half} views: {learned.location(thing)}")
for count in range(half + 1, len(cameras) + 1):
    scene_so_far = (gaussians, cameras[:count], regions)
    sums = scoup.region_sums(*scene_so_far, sums=sums)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        field = scoup.build(*scene_so_far, sources=sources, sums=sums, codebook=learned)
    if any("the codebook explains" in str(each.message) for each in caught):  # things of a new kind
        field = learned = scoup.build(*scene_so_far, sources=sources, sums=sums)
        print("a new codebook was learned")
    print(f"{count} views: {field.location(thing)}")
