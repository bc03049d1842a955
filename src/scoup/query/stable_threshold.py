"""A threshold without tuning: the one at which the answer changes least as the threshold moves.

The papers fix one threshold per data set (0.6, 0.3, 0.45). Where a thing stands out, relevancy falls steeply at its
border, and the area above a threshold hardly depends on it. So the threshold is the one at which the logarithm of that
area changes least over a window, like maximally stable extremal regions of pictures (Matas, Chum, Urban and Pajdla
2002). Measured in docs/answers.md.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from scoup.query.selection import BINS


@dataclass(frozen=True)
class Stability:
    """The rule of stability. All values are on the rescaled relevancy, as the papers' thresholds are.

    Of thresholds that are almost as stable, the one nearer to the centre is taken: its distance times the pull is added
    to the change.
    """

    lowest: float = 0.44  # threshold considered
    highest: float = 0.84
    window: float = 0.1  # over which the change of area is taken
    centre: float = 0.64
    pull: float = 0.05

    @property
    def lowest_share(self) -> float:
        """The share of the span, before rescaling, where the lowest window begins; lower values do not count."""
        return 0.5 + 0.5 * (self.lowest - self.window / 2)


STABILITY = Stability()


def thresholds_of_counts(counts: Tensor, stability: Stability = STABILITY) -> Tensor:
    """Return the most stable threshold of each row.

    Args:
        counts: [S, ``BINS``] of values of relevancy (``stretched_counts``).
        stability: the rule.

    Returns:
        [S] float32 on the CPU, on the rescaled relevancy. Rows that are empty, constant or not finite have the centre.
    """
    above = counts.double().flip(1).cumsum(1).flip(1)  # values in bin b and further up
    area = above.clamp(min=1).log()
    half = round(stability.window / 2 * BINS)
    bins = torch.arange(round(stability.lowest * BINS), round(stability.highest * BINS) + 1)
    bins = bins[(bins >= half) & (bins < BINS - half)]
    change = area[:, bins - half] - area[:, bins + half]
    at = bins / BINS
    best = (change + stability.pull * (at - stability.centre).abs()).argmin(1)
    return at[best].float()
