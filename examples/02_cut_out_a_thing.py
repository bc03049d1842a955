"""Cut a thing out of a scene: save its Gaussians as a splat, and the field of all the others.

python examples/02_cut_out_a_thing.py demo/demo.scoup demo/scene/text.npz teapot teapot.ply without.scoup
"""

import sys

import scoup

path, words, thing, out, rest = sys.argv[1:6]

field = scoup.LanguageField.load(path)
place = field.location(field.question(thing, encoder=words, neighbours=10))
scoup.save_gaussians(field.gaussians.select(place.gaussians), out)

others = ~place.answer.mask
field[others].save(rest)
print(f"{len(place.gaussians)} of {len(field)} Gaussians saved to {out}, {int(others.sum())} to {rest}")
