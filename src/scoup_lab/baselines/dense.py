"""Dense uplift: the mean of full embeddings for each Gaussian, by blending weights (as in LUDVIG, without diffusion).

It stores D floats a level for each Gaussian, which is what sparse codes avoid, and serves as the upper reference for
what coding loses.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from scoup.uplift import RegionSums
from scoup_lab.baselines.fitted import FittedChannels, embedding_cosines
from scoup_lab.baselines.method import MethodSettings
from scoup_lab.baselines.rasterised_scene import UpliftInputs


def dense_features(sums: RegionSums, rows: Tensor, level: int) -> Tensor:
    """Return [N, C] float32 unit-norm features of one level; zero rows where nothing contributed.

    ``rows``: [R, C] of the regions of the level, embeddings or the like, in the order of
    ``Regions.embeddings``.
    """
    summed = torch.from_numpy(sums.matrix(level) @ rows.cpu().numpy())
    return summed.div_(torch.linalg.vector_norm(summed, dim=1, keepdim=True).clamp(min=1e-12))


def mean_features(sums: RegionSums, rows: Tensor, level: int) -> Tensor:
    """Return [N, C] float32 weighted means of one level, as long as they come out: sum of e F / sum of e over
    the pixels with a region (the paper's Eq. 3). The more the regions of a Gaussian disagree, the shorter. Zero
    rows where nothing contributed; arguments as of ``dense_features``.
    """
    matrix = sums.matrix(level)
    total = torch.from_numpy(matrix.sum(1))
    summed = torch.from_numpy(matrix @ rows.cpu().numpy())
    return torch.where(total[:, None] > 0, summed / total[:, None], 0.0)


def weighted_means(sums: RegionSums, rows: Sequence[Tensor]) -> list[Tensor]:
    """Return ``dense_features`` of every level, of rows [R, C] each."""
    return [dense_features(sums, of_level, level) for level, of_level in enumerate(rows)]


def dense_uplift(inputs: UpliftInputs, settings: MethodSettings) -> FittedChannels:
    """Return the weighted mean of embeddings of each Gaussian, scaled to unit norm."""
    return fitted_embeddings(weighted_means(inputs.sums, inputs.embeddings))


def dense_mean_uplift(inputs: UpliftInputs, settings: MethodSettings) -> FittedChannels:
    """Return the weighted mean of embeddings of each Gaussian, not rescaled."""
    rows = enumerate(inputs.embeddings)
    return fitted_embeddings([mean_features(inputs.sums, of_level, level) for level, of_level in rows])


def fitted_embeddings(features: Sequence[Tensor]) -> FittedChannels:
    """Return Gaussians that each keep an embedding [N, D] a level, as floats."""
    size = 4.0 * sum(rows.shape[1] for rows in features)
    return FittedChannels(features, [embedding_cosines] * len(features), size)
