"""The whole pipeline, one public call per step: the fork point for research. Replace any step by your own.

    python examples/00_pipeline.py SCENE mobile-sam laion/CLIP-ViT-B-16-laion2B-s34B-b88K kettle kettle.scoup

Arguments: a scene folder with a splat, cameras and photographs, a segmenter, an embedder (docs/extract.md has their
names), a text, the field to write, and, if the embedder has no text model, a word table. Regions that the scene has
(`language_features`, by the embedder named) are used as they are. `scoup.build` does steps 2 to 7 in one call, with
provenance.
"""

import sys
from pathlib import Path

import scoup
from scoup.extract import extract, find_photographs, open_embedder, open_segmenter

if len(sys.argv) < 6:
    sys.exit(__doc__)
scene, segmenter, embedder, text, out, *words = sys.argv[1:]
gaussians = scoup.load_gaussians(scene)
cameras = scoup.load_cameras(scene)


def progress(stage, done, total):
    print(f"\r{stage}: {done} of {total}", end="" if done < total else "\n", file=sys.stderr)


# 1. Photographs to regions: masks at three levels, one embedding per region. A second run continues the first.
folder = Path(scene, "language_features")
if not folder.is_dir():
    folder = f"{out}.regions"
    models = open_segmenter(segmenter), open_embedder(embedder)
    extract(find_photographs(scene), folder, *models, progress=progress)
regions = scoup.load_regions(folder, cameras)
embeddings = scoup.RegionEmbeddings.load(regions)  # per level [R, D], of the regions of all views
settings = scoup.BuildSettings()

# 2. Do splat and cameras fit? Renders of some views are compared with their photographs.
scoup.check_scene(gaussians, cameras, settings)

# 3. A codebook of 128 atoms per level, and a code of 4 atoms per region.
codes = scoup.code_regions(embeddings, settings, progress=progress)

# 4. Rasterise each view once: how much each Gaussian contributes to each region. The rest is algebra on it, which you
# can repeat with other codes.
sums = scoup.region_sums(gaussians, cameras, regions, settings, progress=progress)

# 5. Merge the regions of many views into things.
things = scoup.find_things(sums, embeddings.of_levels, progress).table

# 6. Lift the codes of the regions onto the Gaussians.
voted = scoup.vote(sums, codes.codes, codes.codebook, settings.rounds, settings.keep, progress=progress)

# 7. The field, as a file.
info = scoup.FieldInfo(regions.levels, embedder, sums.fingerprint, len(gaussians))
field = scoup.pack(voted, codes.codebook, things, info, gaussians, cameras)
field.save(out, overwrite=True)

# 8. Ask it: once in the scene; a view draws that answer.
field = scoup.LanguageField.of(field, words[0] if words else None)
answer = field.answer(text)
print(answer)
print(field.at(cameras[0]).show([answer])[0])
