"""Scores of masks and points against ground truth, and confidence intervals of their means."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from torch import Tensor

from scoup.base import InputError

_SAMPLES = 2000  # of a bootstrap


def iou(predicted: Tensor, truth: Tensor) -> float:
    """Return intersection over union of two boolean masks of one shape; 1 if both are empty."""
    if predicted.shape != truth.shape:
        raise InputError(f"masks of different shapes {list(predicted.shape)} and {list(truth.shape)}")
    union = int((predicted | truth).sum())
    return int((predicted & truth).sum()) / union if union else 1.0


def any_inside(pixels: Tensor, boxes: Tensor) -> bool:
    """Return whether any pixel lies in any box, borders included.

    ``pixels``: [M, 2] (x, y); ``boxes``: [B, 4] (x1, y1, x2, y2), x1 <= x2 and y1 <= y2.
    """
    inside = (pixels[:, None] >= boxes[None, :, :2]) & (pixels[:, None] <= boxes[None, :, 2:])
    return bool(inside.all(-1).any())


@dataclass(frozen=True)
class Interval:
    """A mean with its confidence interval."""

    mean: float
    low: float
    high: float

    @property
    def ends(self) -> list[float]:
        """[low, high], for JSON."""
        return [self.low, self.high]

    def percent(self) -> tuple[str, str]:
        """Return cells of a table: the mean and the interval of a share, in percent."""
        return f"{100 * self.mean:.1f}", f"{100 * self.low:.1f} to {100 * self.high:.1f}"

    def signed(self) -> str:
        """Return a difference in percent points, with signs."""
        return f"{100 * self.mean:+.1f} [{100 * self.low:+.1f}, {100 * self.high:+.1f}]"


def bootstrap_interval(
    values: Sequence[float], groups: Sequence[str], scenes: Sequence[str] | None = None
) -> Interval:
    """Return the mean with its 95 % percentile bootstrap, drawing whole groups with replacement.

    The pairs of one query in several frames are not independent, so queries are drawn, not pairs. For a
    paired comparison of two methods pass the differences of their values.
    """
    scenes = [""] * len(values) if scenes is None else scenes
    if len(values) != len(groups) or len(scenes) != len(groups) or not len(values):
        raise InputError(
            f"{len(values)} values in {len(groups)} groups; there must be one group (and scene) for each, "
            "at least one"
        )
    numbers = np.asarray(values, dtype=np.float64)
    if not np.isfinite(numbers).all():
        raise InputError("values to average must be finite")
    names, kinds = np.asarray(groups, dtype=str), np.asarray(scenes, dtype=str)
    generator = np.random.default_rng(0)
    parts = [
        (numbers[kinds == kind].mean(), _drawn_means(numbers[kinds == kind], names[kinds == kind], generator))
        for kind in np.unique(kinds)
    ]
    mean = np.mean([mean for mean, _ in parts])
    means = np.mean([drawn for _, drawn in parts], axis=0)
    low, high = np.quantile(means, [0.025, 0.975])
    return Interval(float(mean), float(low), float(high))


def _drawn_means(numbers: np.ndarray, groups: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """Return means [_SAMPLES] of values [V] float64 under draws of their groups [V]."""
    _, members = np.unique(groups, return_inverse=True)
    sums = np.bincount(members, numbers)
    counts = np.bincount(members)
    draws = generator.integers(len(sums), size=(_SAMPLES, len(sums)))
    return sums[draws].sum(1) / counts[draws].sum(1)
