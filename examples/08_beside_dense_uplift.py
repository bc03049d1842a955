"""Compare sparse codes with dense uplift of whole embeddings, from the same region sums.

    python examples/08_beside_dense_uplift.py demo/scene demo/scene/text.npz teapot

Dense uplift keeps the mean embedding of each Gaussian: D numbers per level. It is the reference for what codes lose.
"""

import sys

import torch

import scoup
from scoup_lab.baselines.dense import dense_uplift
from scoup_lab.baselines.method import MethodSettings
from scoup_lab.baselines.rasterised_scene import UpliftInputs

if len(sys.argv) < 4:
    sys.exit(__doc__)
scene, words, thing = sys.argv[1:4]
gaussians = scoup.load_gaussians(scene)
cameras = scoup.load_cameras(scene)
regions = scoup.load_regions(scene, cameras)
sums = scoup.region_sums(gaussians, cameras, regions)
field = scoup.build(gaussians, cameras, regions, sources=scoup.FieldSources(words=words), sums=sums)
inputs = UpliftInputs(sums, [regions.embeddings(level)[0] for level in regions.levels])
dense = dense_uplift(inputs, MethodSettings(seed=0))

question = field.question(thing)
sparse_relevancy = field.gaussian_relevancy(question.queries, question.canonical)[:, 0]
dense_relevancy = dense.gaussian_relevancy(question.queries, question.canonical)[:, 0]
indices, weights = field.code_indices, field.code_weights
size = (indices.element_size() + weights.element_size()) * indices.shape[1] * indices.shape[2]
print(f"bytes a Gaussian: {size} sparse, {dense.bytes_per_gaussian:.0f} dense")
for level, name in enumerate(field.levels):
    both = field.coded() & dense.coded()[level]
    pair = torch.stack([sparse_relevancy[level, both], dense_relevancy[level, both]])
    print(f"level {name}: correlation of relevancies {float(torch.corrcoef(pair)[0, 1]):.3f}")
