"""Rounds of the vote after the first: regions count by their cosine with what each Gaussian was found to be.

Own; the one-round vote is method.md, stage 2. In a later round region r counts for Gaussian i not A[i, r] but
A[i, r] exp(sharpness (cos - 1)), and at least ``LEAST_FACTOR`` of A[i, r]. cos is the cosine between the decoded
code of the region and that of the Gaussian. So masks that bleed over an edge and embeddings of something else count
less. A Gaussian without a code counts all regions alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

LEAST_FACTOR = 1e-6  # no Gaussian loses its code for being odd
SHARPNESS = 3.0  # times the inverse of the usual deviation
LEAST_DEVIATION = 1e-3  # 1 - cosine; identical regions would make it infinite
SAMPLED_VIEWS = 8


@dataclass(frozen=True, eq=False)
class EarlierRound:
    """What a round has found, and how strictly regions are held to it in the next.

    Attributes:
        indices: [N, S, K] uint8 (uint16 beyond 256 atoms).
        weights: [N, S, K] float32, scaled so that each decoded code has unit norm; zeros for no code.
        sharpness: [S] float32, 0 or more; 0 counts all regions alike.
    """

    indices: Tensor  # [N, S, K]
    weights: Tensor  # [N, S, K]
    sharpness: Tensor  # [S]


def sharpness_from(deviations: Sequence[Tensor]) -> Tensor:
    """[S] float32: ``SHARPNESS`` over the median deviation 1 - cosine of regions from the Gaussians they paint.

    So a region that deviates as usual counts exp(-3), and what is usual is learned from the scene itself: noisy
    embeddings are held to less strictly.

    Args:
        deviations: per level, those of each pair of a Gaussian and a region in the sampled views.
    """
    medians = [of_level.median() if len(of_level) else of_level.new_ones(()) for of_level in deviations]
    return SHARPNESS / torch.stack(medians).float().cpu().clamp(min=LEAST_DEVIATION)
