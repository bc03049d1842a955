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

from scoup.query.smoothing import rescale

_BINS = 100


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

    def lowest_counted(self, low: Tensor, high: Tensor) -> Tensor:
        """Return where the lowest window begins between two values, before rescaling; lower values do not count."""
        # A little lower than needed, for rounding.
        return low + (high - low) * (0.5 + 0.5 * (self.lowest - self.window / 2)) - 1e-6


STABILITY = Stability()


def stable_thresholds(
    values: Tensor,
    fixed: float | None = None,
    stability: Stability = STABILITY,
    is_rescaled: bool = False,
) -> tuple[Tensor, Tensor]:
    """Return the most stable threshold of each row, and the instability of the answer there.

    Args:
        values: [S, M] relevancy of pixels or Gaussians, finite.
        fixed: take this threshold instead.
        stability: the rule.
        is_rescaled: the values are rescaled already; those that do not count may be left out.

    Returns:
        thresholds [S] on the rescaled relevancy (``rescale``), and the change [S] of the logarithm of the area over the
        window there: 0 for a step, 2 and more for what fades away. Both float32 on the CPU. Rows that are empty,
        constant or not finite have the centre and 0.
    """
    middle = stability.centre if fixed is None else fixed
    found = []
    for row in values:
        if fixed is None and row.numel() and not is_rescaled:
            low, high = row.aminmax()
            row = rescale(row[row >= stability.lowest_counted(low, high)], low, high)
        elif row.numel() and not is_rescaled:
            row = rescale(row)
        found.append(_stable(row, fixed, stability) if row.numel() else (middle, 0.0))
    thresholds, changes = zip(*found, strict=True) if found else ((), ())
    return torch.tensor(thresholds, dtype=torch.float32), torch.tensor(changes, dtype=torch.float32)


def _stable(rescaled: Tensor, fixed: float | None, stability: Stability) -> tuple[float, float]:
    """Threshold and change of rescaled relevancy [M]."""
    counts = torch.histc(rescaled.float(), _BINS, 0, 1).double().cpu()
    above = counts.flip(0).cumsum(0).flip(0)  # values in bin b and further up
    area = above.clamp(min=1).log()
    half = round(stability.window / 2 * _BINS)
    if fixed is not None:
        at = min(max(round(fixed * _BINS), half), _BINS - 1 - half)
        return fixed, float(area[at - half] - area[at + half])
    bins = torch.arange(round(stability.lowest * _BINS), round(stability.highest * _BINS) + 1)
    bins = bins[(bins >= half) & (bins < _BINS - half)]
    change = area[bins - half] - area[bins + half]
    at = bins / _BINS
    best = int((change + stability.pull * (at - stability.centre).abs()).argmin())
    return float(at[best]), float(change[best])
