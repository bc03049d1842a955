"""Build a language field and ask it where something is.

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

text = scoup.TextEncoder.open(words)
query, canonical = text.encode([thing]), text.canonical(everyday=True)
for camera in cameras[:3]:
    relevancy = field.relevancy(camera, query, canonical)[:, 0]  # [levels, H, W]
    place, shape = scoup.localize(relevancy), scoup.segment(relevancy)
    print(f"{camera.name}: pixel {place.pixel}, box {shape.box}, level {field.levels[shape.level]}")
