"""Select the Gaussians that answer a query and save them as a splat.

python examples/02_cut_out_a_thing.py demo/demo.scoup demo/scene/text.npz teapot teapot.ply
"""

import sys

import scoup

path, words, thing, out = sys.argv[1:5]

field = scoup.LanguageField.load(path)
text = scoup.TextEncoder.open(words)
selected = scoup.select(field, text.encode([thing])[0], text.canonical(everyday=True), neighbours=10)
scoup.save_gaussians(field.gaussians.select(selected), out)
print(f"{int(selected.sum())} of {len(field)} Gaussians saved to {out}")
