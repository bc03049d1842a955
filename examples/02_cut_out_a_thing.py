"""Cut a thing out of a scene: save its Gaussians as a splat, and the field of all the others.

python examples/02_cut_out_a_thing.py demo/demo.scoup demo/scene/text.npz teapot teapot.ply without.scoup
"""

import sys

import scoup

if len(sys.argv) < 6:
    sys.exit(__doc__)
path, words, thing, out, rest = sys.argv[1:6]

field = scoup.LanguageField.load(path, words=words)
answer = field.answer(thing)
scoup.save_gaussians(field.gaussians.select(answer.mask), out)
field[~answer.mask].save(rest)
print(f"{int(answer.mask.sum())} of {len(field)} Gaussians saved to {out}, the others to {rest}")
