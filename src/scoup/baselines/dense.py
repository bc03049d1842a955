"""Dense uplift: the blending-weighted mean of full embeddings for each Gaussian (as in LUDVIG, without diffusion).

It keeps D floats a level for each Gaussian, which is what sparse codes avoid, and serves as the upper reference for
what coding loses.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from scoup import raster
from scoup.field.relevancy import relevancy
from scoup.uplift.region_sums import RegionSums

ROWS_AT_A_TIME = 128  # image rows normalised and compared together


def dense_features(sums: RegionSums, embeddings: Sequence[Tensor], level: int) -> Tensor:
    """[N, D] float32 unit-norm features of one level; zero rows where nothing painted.

    Args:
        sums: region sums of all views.
        embeddings: per level [R, D], in the order of ``Regions.embeddings``.
        level: position of the level.
    """
    summed = torch.from_numpy(sums.matrix(level) @ embeddings[level].cpu().numpy())
    return torch.nn.functional.normalize(summed, dim=1)


def weighted_means(sums: RegionSums, rows: Sequence[Tensor]) -> list[Tensor]:
    """``dense_features`` of every level, of rows [R, C] of any kind."""
    return [dense_features(sums, rows, level) for level in range(len(rows))]


def dense_relevancy(view: raster.Projection, features: Tensor, queries: Tensor, canonical: Tensor) -> Tensor:
    """Relevancy of one level from rendered D-channel features: [Q, H, W] float32.

    The whole D-channel image is made, a few times H x W x D x 4 bytes: that is what a dense field costs.

    Args:
        view: from ``raster.project``.
        features: [N, D].
        queries, canonical: [Q, D] and [P, D], unit norm.
    """
    image, _ = raster.render_channels(view, features)
    both = torch.cat([queries, canonical])
    cosines = torch.empty(len(both), view.height, view.width, device=features.device)
    for rows in torch.arange(view.height).split(ROWS_AT_A_TIME):
        unit = torch.nn.functional.normalize(image[rows], dim=-1)
        cosines[:, rows] = (unit @ both.T).permute(2, 0, 1)
    count = len(queries)
    return relevancy(cosines[None, :count], cosines[None, count:])[0]
