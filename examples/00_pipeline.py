"""The whole pipeline, one public call per step: the fork point for research. Replace any step by your own.

    python examples/00_pipeline.py SCENE mobile-sam laion/CLIP-ViT-B-16-laion2B-s34B-b88K kettle kettle.scoup

Arguments: a scene folder with a splat, cameras and photographs, a segmenter, an embedder (docs/extract.md has their
names), a text, the field to write, and, if the embedder has no text model, a word table. `scoup.build` does steps 2 to
5 in one call, with checks and provenance.
"""

import sys

import torch

import scoup
from scoup.extract import extract, find_photographs, open_embedder, open_segmenter

if len(sys.argv) < 6:
    sys.exit(__doc__)
scene, segmenter, embedder, text, out, *words = sys.argv[1:]
gaussians = scoup.load_gaussians(scene)
cameras = scoup.load_cameras(scene)

# 1. Photographs to regions: masks at three levels, one embedding per region. A second run continues the first.
extract(find_photographs(scene), f"{out}.regions", open_segmenter(segmenter), open_embedder(embedder))
regions = scoup.load_regions(f"{out}.regions", cameras)
embeddings = [regions.embeddings(level)[0] for level in regions.levels]  # S x [R, D]

# 2. A codebook of 128 atoms per level, and a code of 4 atoms per region.
books = [scoup.fit_codes(rows, n_atoms=128, k=4) for rows in embeddings]
codebook = torch.stack([book.atoms for book in books])  # [S, L, D]

# 3. Rasterise each view once: how much each Gaussian contributes to each region. The rest is algebra on it, which you
# can repeat with other codes.
sums = scoup.region_sums(gaussians, cameras, regions)

# 4. Lift the codes of the regions onto the Gaussians, and merge regions of many views into things.
codes = scoup.vote(sums, [book.codes for book in books], codebook, rounds=2)
things = scoup.find_things(sums, embeddings).table

# 5. The field, as a file.
info = scoup.FieldInfo(regions.levels, embedder, sums.fingerprint, len(gaussians))
parts = codes.indices, codes.weights, codebook
table = words[0] if words else None
field = scoup.LanguageField(*parts, info, gaussians, cameras=cameras, thing_table=things, words=table)
field.save(out, overwrite=True)

# 6. Ask it: once in the scene; a view draws that answer.
answer = field.answer(text)
print(answer)
print(field.at(cameras[0]).show([answer])[0])
