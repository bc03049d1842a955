"""The pixels of a view that answer a query (docs/protocols.md, LERF-OVS, steps 1 to 4)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from scoup.base.brief import brief
from scoup.query.localize import Localization, averaged_relevancy, localize
from scoup.query.presets import QUERY_PRESETS, LevelChoice, QueryPreset
from scoup.query.smoothing import mask_parts, mask_sums, smoothed_masks
from scoup.query.stable_threshold import stable_thresholds

LEAST_SHARE, LEAST_PEAK = 0.02, 0.8
"""A part of a mask is a stray if its area, or the excess of its largest relevancy over a draw (0.5), is below this
share of that of the part with the point (docs/benchmarks.md, "Where things are")."""
DRAW = 0.5
STABLE, WHOLE, LEAST_INSTABILITY = 0.08, 0.05, 0.005
"""Weights of stability and of containing another level's mask, beside the mean relevancy in a mask; and the least
instability that counts."""


@dataclass(frozen=True, eq=False)
class Segmentation:
    """The pixels that answer a query."""

    mask: Tensor
    """[H, W] boolean."""
    smoothed: Tensor
    """[H, W] smoothed relevancy at the level chosen, dtype of the relevancy."""
    level: int
    """Position of the level chosen."""
    score: float
    """The largest smoothed relevancy at that level, 0..1."""
    coverage: float
    """Share of the image in the mask, 0..1."""
    threshold: float | None
    """Threshold of the mask on the rescaled relevancy; None for the mask of a thing."""

    __repr__ = brief

    def core(self) -> Tensor:
        """Return the more relevant half of the mask, [H, W] boolean; of an empty mask, the most relevant pixels.

        It leaves out borders, where things mix.
        """
        if not self.mask.any():
            return self.smoothed == self.smoothed.max()
        return self.mask & (self.smoothed >= self.smoothed[self.mask].median())


def segment(
    relevancy: Tensor | ArrayLike,
    preset: QueryPreset = QUERY_PRESETS["default"],
    averaged: Tensor | None = None,
) -> Segmentation:
    """Return the pixels of one view that answer a query.

    Args:
        relevancy: [S, H, W] of one query, 0..1.
        preset: box, threshold, mask smoothing and choice of the level.
        averaged: ``averaged_relevancy`` of both, if known.

    Raises:
        InputError: relevancy has another shape, or is empty.

    Example:
        >>> relevancy = torch.zeros(3, 20, 30)  # levels, rows, columns
        >>> relevancy[1, 4:9, 10:15] = 0.9
        >>> found = scoup.segment(relevancy)
        >>> found.mask.shape
        torch.Size([20, 30])
    """
    found = level_masks(torch.as_tensor(relevancy), preset, averaged)
    peaks, areas, sums = mask_sums(found.smoothed, found.masks)
    level = _chosen_level(found, preset.level_choice, peaks, areas, sums)
    mask = found.masks[level]
    # A copy, so that the other levels can be freed.
    shown = found.smoothed[level].clone()
    coverage = int(areas[level]) / mask.numel()
    threshold = float(found.thresholds[level])
    return Segmentation(mask, shown, level, float(peaks[level]), coverage, threshold)


def localize_and_segment(
    relevancy: Tensor, preset: QueryPreset = QUERY_PRESETS["default"]
) -> tuple[Localization, Segmentation]:
    """Return ``localize`` and ``segment`` of one query, computing box means once."""
    averaged = averaged_relevancy(relevancy, preset)
    return localize(relevancy, preset, averaged), segment(relevancy, preset, averaged)


@dataclass(frozen=True, eq=False)
class LevelMasks:
    """The mask of every level."""

    smoothed: Tensor  # [S, H, W] smoothed relevancy
    masks: Tensor  # [S, H, W] boolean
    thresholds: Tensor  # [S] float32 on the CPU, of the masks, on the rescaled relevancy
    instability: Tensor  # [S] float32 on the CPU, from ``stable_thresholds``


def level_masks(relevancy: Tensor, preset: QueryPreset, averaged: Tensor | None = None) -> LevelMasks:
    """Return the mask of every level (protocols.md, LERF-OVS, steps 1 to 3); arguments as for ``segment``."""
    averaged = averaged_relevancy(relevancy, preset) if averaged is None else averaged
    thresholds, instability = stable_thresholds((0.5 * (relevancy + averaged)).flatten(1), preset.threshold)
    smoothed, masks = smoothed_masks(
        relevancy, averaged, thresholds, preset.smoothing, preset.smoothing_border
    )
    return LevelMasks(smoothed, masks, thresholds, instability)


def choose_level(found: LevelMasks, choice: LevelChoice) -> int:
    """Return the position of the level that answers (protocols.md, LERF-OVS, step 4); the first of equals.

    With "mask" and "evidence", a level with an empty mask is never chosen, unless all are empty: then the peak decides.

    A part may outscore its whole: the head of a person is nearer to "person" than the whole is, clothes included. So
    "evidence" adds to the mean relevancy in the mask ``-STABLE`` times the logarithm of the mask's instability, and
    ``WHOLE`` times the largest share of a smaller mask of another level that lies inside (docs/answers.md).
    """
    return _chosen_level(found, choice, *mask_sums(found.smoothed, found.masks))


def _chosen_level(found: LevelMasks, choice: LevelChoice, peaks: Tensor, areas: Tensor, sums: Tensor) -> int:
    """``choose_level`` with what ``mask_sums`` gives."""
    if choice == "peak" or not areas.any():
        return int(peaks.argmax())
    evidence = (sums / areas).cpu()
    if choice == "evidence":
        stability = -found.instability.double().clamp(min=LEAST_INSTABILITY).log()
        evidence += STABLE * stability + WHOLE * _contained(found.masks, areas)
    return int(torch.where(areas.cpu() > 0, evidence, -torch.inf).argmax())


def _contained(masks: Tensor, areas: Tensor) -> Tensor:
    """[S] float64, the largest share of a smaller mask of another level that lies in each mask; 0 without one."""
    sizes = areas.tolist()
    held = torch.zeros(len(masks), dtype=torch.float64)
    for level, mask in enumerate(masks):
        smaller = [other for other, size in enumerate(sizes) if 0 < size < sizes[level]]
        shares = [int((masks[other] & mask).sum()) / sizes[other] for other in smaller]
        held[level] = max(shares, default=0.0)
    return held


def mask_box(mask: Tensor) -> tuple[int, int, int, int] | None:
    """Return (x0, y0, x1, y1) around the true pixels of [H, W], x1 and y1 one past the last; None of an empty mask."""
    if not mask.numel():
        return None
    bits = mask.view(torch.uint8)  # torch finds their largest much sooner than any of a boolean
    rows, columns = bits.amax(1).nonzero()[:, 0], bits.amax(0).nonzero()[:, 0]
    if not len(rows):
        return None
    return int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1


def main_parts(
    mask: Tensor, point: tuple[int, int], heat: Tensor, least_share: float = LEAST_SHARE
) -> Tensor:
    """Return a mask without strays: the connected part with a point, and parts alike in size and relevancy.

    Pixels that touch at a corner are connected. Things are often seen in pieces, with something in front of them, so
    the part with the point alone would be too little. Strays are specks, and patches of other things that resemble it.

    Args:
        mask: [H, W] boolean, on the CPU.
        point: (x, y); if it is not in the mask, the mask's most relevant pixel takes its place.
        heat: [H, W] relevancy at the level of the mask, on the CPU.
        least_share: see ``LEAST_SHARE``; infinity returns the part with the point alone.
    """
    if not mask.any():
        return mask
    x, y = point
    if not mask[y, x]:
        y, x = divmod(int(torch.where(mask, heat, -torch.inf).argmax()), mask.shape[1])
    parts, count = mask_parts(mask.numpy())
    own = parts[y, x]
    inside = np.flatnonzero(mask.numpy())
    of_pixels, excess = parts.ravel()[inside], heat.numpy().ravel()[inside] - np.float64(DRAW)
    areas = np.bincount(of_pixels, minlength=count + 1)
    hot = of_pixels[excess >= LEAST_PEAK * excess[of_pixels == own].max()]
    kept = (areas >= least_share * areas[own]) & (np.bincount(hot, minlength=count + 1) > 0)
    kept[own] = True
    found = torch.zeros_like(mask)
    found.view(-1)[torch.from_numpy(inside)] = torch.from_numpy(kept[of_pixels])
    return found
