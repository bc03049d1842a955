"""Build a language field and query it for a thing: in the views, and in the world.

    python examples/01_build_and_query.py demo/scene demo/scene/text.npz teapot

Arguments: a scene folder with a splat, cameras and language_features (`make demo` writes one), a word table, and the
query.
"""

import sys

import scoup

if len(sys.argv) < 4:
    sys.exit(__doc__)
scene, words, thing = sys.argv[1:4]

gaussians = scoup.load_gaussians(scene)
cameras = scoup.load_cameras(scene)
regions = scoup.load_regions(scene, cameras)
field = scoup.build(gaussians, cameras, regions, sources=scoup.FieldSources(words=words))

for camera in cameras[:3]:
    answer = field.at(camera).answer(thing)
    print(f"{camera.name}: pixel {answer.point}, box {answer.box}, level {answer.level}")
place = field.location(thing)
print(f"in the world: {place}")
