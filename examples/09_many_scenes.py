"""Ask several fields the same: which of the rooms has it, and where.

python examples/09_many_scenes.py demo/scene/text.npz teapot demo/demo.scoup other.scoup
"""

import sys

import scoup

if len(sys.argv) < 4:
    sys.exit(__doc__)
words, thing, *paths = sys.argv[1:]
encoder = scoup.TextEncoder.open(words)  # once for all
found = []
for path in paths:
    field = scoup.LanguageField.load(path)
    found.append((field.location(field.question(thing, encoder=encoder)), path))
found.sort(key=lambda pair: (pair[0].presence, pair[0].answer.score or 0.0), reverse=True)
for place, path in found:
    print(f"{path}: {place}")
