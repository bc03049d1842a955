"""Rasterise a scene once, then build codes with several codebooks from the same region sums.

    python examples/03_rasterise_once_code_often.py demo/scene

Everything after rasterising needs only the region sums: the blending weights of each Gaussian, summed over each region.
"""

import sys

import torch

import scoup

scene = sys.argv[1]
gaussians = scoup.load_gaussians(scene)
cameras = scoup.load_cameras(scene)
regions = scoup.load_regions(scene, cameras)
sums = scoup.region_sums(gaussians, cameras, regions)

embeddings = [regions.embeddings(level)[0] for level in regions.levels]
for n_atoms in (32, 64):
    books = [scoup.fit_codes(rows, n_atoms, k=4) for rows in embeddings]
    codebook = torch.stack([book.atoms for book in books])
    voted = scoup.vote(sums, [book.codes for book in books], codebook, rounds=2, keep=4)
    cosines = ", ".join(
        f"{level} {book.report.mean_cosine:.3f}" for level, book in zip(regions.levels, books, strict=True)
    )
    coded = int((voted.weights > 0).flatten(1).any(1).sum())
    print(
        f"{n_atoms} atoms: mean cosine {cosines}; codes {list(voted.indices.shape)}, {coded} Gaussians coded"
    )
