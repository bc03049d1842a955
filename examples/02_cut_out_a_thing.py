"""Cut the Gaussians that answer a text out of a scene and save them as a splat.

python examples/02_cut_out_a_thing.py demo/demo.scoup demo/scene/text.npz teapot teapot.ply
"""

import sys

import scoup

path, words, thing, out = sys.argv[1:5]

field = scoup.LanguageField.load(path)
text = scoup.TextEncoder.open(words)
chosen = scoup.select(field, text.encode([thing])[0], text.canonical(everyday=True), neighbours=10)
scoup.save_gaussians(field.gaussians.select(chosen), out)
print(f"{int(chosen.sum())} of {len(field)} Gaussians saved to {out}")
