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
from scoup.query.smoothing import mask_sums, smoothed_masks
from scoup.query.stable_threshold import stable_thresholds

LEAST_SHARE, LEAST_PEAK = 0.02, 0.8
"""Parts of a mask are strays if they are smaller than this share of the part that holds the point, or if their largest
relevancy exceeds a draw (0.5) by less than this share of what that of the part exceeds it by (docs/benchmarks.md,
"Where things are")."""
DRAW = 0.5
STABLE, WHOLE, LEAST_INSTABILITY = 0.08, 0.05, 0.005
"""What stability and holding another level's mask count beside the relevancy in a mask; a mask that changes less counts
as one that changes so much."""


@dataclass(frozen=True, eq=False)
class Segmentation:
    """Which pixels a query is.

    Attributes:
        mask: [H, W] boolean.
        smoothed: [H, W] smoothed relevancy at the level chosen, dtype of the relevancy.
        level: position of the level chosen.
        score: the largest smoothed relevancy at that level, 0..1.
        coverage: share of the image in the mask, 0..1.
        threshold: of the mask, on the rescaled relevancy; None for the mask of a thing.
    """

    mask: Tensor  # [H, W]
    smoothed: Tensor  # [H, W]
    level: int
    score: float
    coverage: float
    threshold: float | None

    __repr__ = brief

    def core(self) -> Tensor:
        """[H, W] boolean: the more relevant half of the mask; of an empty mask, the most relevant pixels.

        Borders, where things mix, are not in it.
        """
        if not self.mask.any():
            return self.smoothed == self.smoothed.max()
        return self.mask & (self.smoothed >= self.smoothed[self.mask].median())


def segment(
    relevancy: Tensor | ArrayLike,
    preset: QueryPreset = QUERY_PRESETS["default"],
    averaged: Tensor | None = None,
) -> Segmentation:
    """The pixels of one view that answer a query.

    Args:
        relevancy: [S, H, W] of one query, 0..1.
        preset: box, threshold, mask smoothing and choice of the level.
        averaged: what ``averaged_relevancy`` gives for both, if it is known already.

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
    """Point and mask of one view; the box means are computed once.

    Args:
        relevancy: [S, H, W] of one query, 0..1.
        preset: how relevancy becomes points and masks.

    Raises:
        InputError: relevancy has another shape, or is empty.
    """
    averaged = averaged_relevancy(relevancy, preset)
    return localize(relevancy, preset, averaged), segment(relevancy, preset, averaged)


@dataclass(frozen=True, eq=False)
class LevelMasks:
    """The mask of every level.

    Attributes:
        smoothed: [S, H, W] smoothed relevancy, dtype of the relevancy.
        masks: [S, H, W] boolean.
        thresholds: [S] float32 on the CPU, of the masks, on the rescaled relevancy.
        instability: [S] float32 on the CPU, how much the masks depend on their thresholds
            (``scoup.query.stable_threshold``).
    """

    smoothed: Tensor  # [S, H, W]
    masks: Tensor  # [S, H, W]
    thresholds: Tensor  # [S]
    instability: Tensor  # [S]


def level_masks(relevancy: Tensor, preset: QueryPreset, averaged: Tensor | None = None) -> LevelMasks:
    """The mask of every level (protocols.md, LERF-OVS, steps 1 to 3).

    Args:
        relevancy: [S, H, W] of one query, 0..1.
        preset: box, threshold and mask smoothing.
        averaged: what ``averaged_relevancy`` gives for both, if it is known already.
    """
    averaged = averaged_relevancy(relevancy, preset) if averaged is None else averaged
    thresholds, instability = stable_thresholds((0.5 * (relevancy + averaged)).flatten(1), preset.threshold)
    smoothed, masks = smoothed_masks(
        relevancy, averaged, thresholds, preset.smoothing, preset.smoothing_border
    )
    return LevelMasks(smoothed, masks, thresholds, instability)


def choose_level(found: LevelMasks, choice: LevelChoice) -> int:
    """Position of the level that answers (protocols.md, LERF-OVS, step 4); the first of equals.

    With "mask" and "evidence", a level with an empty mask is never chosen, unless all are empty: then the peak decides.

    A part may outscore its whole: the head of a person is nearer to "person" than the whole is, clothes included. So
    "evidence" adds to the mean relevancy in the mask what speaks for a thing of its own: ``-STABLE`` times the
    logarithm of the mask's instability, and ``WHOLE`` times the largest share of a smaller mask of another level that
    lies inside (docs/answers.md).

    Args:
        found: from ``level_masks``.
        choice: see ``QueryPreset``.
    """
    return _chosen_level(found, choice, *mask_sums(found.smoothed, found.masks))


def _chosen_level(found: LevelMasks, choice: LevelChoice, peaks: Tensor, areas: Tensor, sums: Tensor) -> int:
    """``choose_level`` with what ``mask_sums`` gives."""
    if choice == "peak" or not areas.any():
        return int(peaks.argmax())
    evidence = (sums / areas).cpu()
    if choice == "evidence":
        stability = -found.instability.double().clamp(min=LEAST_INSTABILITY).log()
        evidence += STABLE * stability + WHOLE * _held(found.masks, areas)
    return int(torch.where(areas.cpu() > 0, evidence, -torch.inf).argmax())


def _held(masks: Tensor, areas: Tensor) -> Tensor:
    """[S] float64: the largest share of a smaller mask of another level that lies in each mask; 0 where there is none.

    Args:
        masks: [S, H, W] boolean.
        areas: [S] their pixels.
    """
    sizes = areas.tolist()
    held = torch.zeros(len(masks), dtype=torch.float64)
    for level, mask in enumerate(masks):
        smaller = [other for other, size in enumerate(sizes) if 0 < size < sizes[level]]
        shares = [int((masks[other] & mask).sum()) / sizes[other] for other in smaller]
        held[level] = max(shares, default=0.0)
    return held


def mask_box(mask: Tensor) -> tuple[int, int, int, int] | None:
    """(x0, y0, x1, y1) around the true pixels of [H, W], x1 and y1 one past the last; None if there are
    none.
    """
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
    """A mask without strays: the connected part that holds a point, and those alike in size and relevancy.

    Pixels that touch at a corner are connected. Things are often seen in pieces, with something in front of them: the
    part with the point alone would be too little. Strays are specks, and patches of other things that resemble it.

    Args:
        mask: [H, W] boolean, on the CPU.
        point: (x, y).
        heat: [H, W] relevancy at the level of the mask, on the CPU; where the point is not in the mask, the mask's most
            relevant pixel takes its place.
        least_share: see ``LEAST_SHARE``; infinity leaves the part with the point alone.

    Returns:
        [H, W] boolean; empty if the mask is.
    """
    from scipy import ndimage

    if not mask.any():
        return mask
    x, y = point
    if not mask[y, x]:
        y, x = divmod(int(torch.where(mask, heat, -torch.inf).argmax()), mask.shape[1])
    parts = np.empty(mask.shape, np.int32)
    count = int(ndimage.label(mask.numpy(), np.ones((3, 3)), output=parts))  # pyright: ignore[reportArgumentType]
    own = parts[y, x]
    areas = np.bincount(parts.ravel(), minlength=count + 1)
    peaks = np.append(0.0, ndimage.maximum(heat.numpy(), parts, np.arange(1, count + 1)))
    kept = (areas >= least_share * areas[own]) & (peaks - DRAW >= LEAST_PEAK * (peaks[own] - DRAW))
    kept[own], kept[0] = True, False
    return torch.from_numpy(kept[parts])
