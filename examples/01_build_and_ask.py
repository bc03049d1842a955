"""Build a language field and query it for where something is.

    python examples/01_build_and_ask.py demo/scene demo/scene/text.npz teapot

The first argument is a scene folder with a splat, cameras and language_features (`make demo` writes one), the second a
table of text vectors or a CLIP model, the third what to look for.
"""

import sys

import scoup

scene, words, thing = sys.argv[1:4]

gaussians = scoup.load_gaussians(scene)
cameras = scoup.load_cameras(scene)
regions = scoup.load_regions(scene, cameras)
field = scoup.build(gaussians, cameras, regions)

texts = scoup.encode_texts(scoup.TextEncoder.open(words), field, [thing]).with_everyday()
for camera in cameras[:3]:
    (answer,) = scoup.answer_view(field, camera, texts)
    print(f"{camera.name}: pixel {answer.point}, box {answer.box}, level {answer.level}")
