"""Name every Gaussian by a list of words, and write that for other programs: PLY with ids, GLB, clouds, label maps.

python examples/07_label_and_export.py demo/demo.scoup demo/scene/text.npz labels teapot mug kettle
"""

import sys
from pathlib import Path

import scoup
from scoup.query import LabelFiles

if len(sys.argv) < 5:
    sys.exit(__doc__)
path, words, out, *names = sys.argv[1:]
field = scoup.LanguageField.load(path, words=words)
labels = field.label(names)
print(labels)
outputs = ("sidecar", "ids", "glb", "clouds", "maps", "sheet")
LabelFiles(labels.names, outputs, list(field.cameras or ())).write(field, labels, Path(out))
for file in sorted(Path(out).rglob("*")):
    if file.is_file():
        print(file.relative_to(out))
