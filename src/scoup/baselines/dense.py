"""Dense uplift: the mean of full embeddings for each Gaussian, by blending weights (as in LUDVIG, without diffusion).

It stores D floats a level for each Gaussian, which is what sparse codes avoid, and serves as the upper reference for
what coding loses.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from scoup.baselines.fitted import FittedChannels, embedding_cosines
from scoup.baselines.method import MethodSettings
from scoup.baselines.rasterised_scene import UpliftInputs
from scoup.uplift.region_sums import RegionSums


def dense_features(sums: RegionSums, rows: Tensor, level: int) -> Tensor:
    """[N, C] float32 unit-norm features of one level; zero rows where nothing painted.

    Args:
        sums: region sums of all views.
        rows: [R, C] of the regions of the level, embeddings or the like, in the order of ``Regions.embeddings``.
        level: position of the level.
    """
    summed = torch.from_numpy(sums.matrix(level) @ rows.cpu().numpy())
    return torch.nn.functional.normalize(summed, dim=1)


def weighted_means(sums: RegionSums, rows: Sequence[Tensor]) -> list[Tensor]:
    """``dense_features`` of every level, of rows [R, C] each."""
    return [dense_features(sums, of_level, level) for level, of_level in enumerate(rows)]


def dense_uplift(inputs: UpliftInputs, settings: MethodSettings) -> FittedChannels:
    """The weighted mean of embeddings of each Gaussian, scaled to unit norm."""
    features = weighted_means(inputs.sums, inputs.embeddings)
    size = 4.0 * sum(rows.shape[1] for rows in features)
    return FittedChannels(features, [embedding_cosines] * len(features), size)
