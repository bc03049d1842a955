"""Rounds of the vote after the first: regions count by their cosine with the Gaussian's code of the round before.

Own; the one-round vote is method.md, stage 2. In a later round region r counts for Gaussian i not A[i, r] but
A[i, r] exp(sharpness (cos - 1)), and at least ``LEAST_FACTOR`` of A[i, r]. cos is the cosine between the decoded
code of the region and that of the Gaussian. So masks that bleed over an edge, and embeddings of something else, count
less. A Gaussian without a code counts all regions alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from scoup.uplift import constants


@dataclass(frozen=True, eq=False)
class EarlierRound:
    """The outcome of a round, and how strictly the next one compares regions with it."""

    indices: Tensor  # [N, S, K] uint8 (uint16 beyond 256 atoms)
    weights: Tensor  # [N, S, K] float32, scaled so that each decoded code has unit norm; zeros for no code
    sharpness: Tensor  # [S] float32, 0 or more; 0 counts all regions alike


def scene_sharpness(deviations: Sequence[Tensor]) -> Tensor:
    """Return [S] float32, ``SHARPNESS`` over the median deviation 1 - cosine of regions from their Gaussians.

    So a region with the median deviation counts exp(-3), and noisy embeddings are compared less strictly.
    ``deviations`` has, per level, those of each pair of a Gaussian and a region in the sampled views.
    """
    medians = [of_level.median() if len(of_level) else of_level.new_ones(()) for of_level in deviations]
    return constants.SHARPNESS / torch.stack(medians).float().cpu().clamp(min=constants.LEAST_DEVIATION)
