"""Points and masks from the relevancy maps of one view and query (docs/evaluation.md, steps 1 to 4)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from scoup.base import InputError
from scoup_lab.evaluate.rules import Border, LevelChoice, MaskRule, VoteBorder


@dataclass(frozen=True, eq=False)
class Localization:
    """The most relevant place in a view."""

    pixels: Tensor  # [M, 2] int64 (x, y), all pixels of maximal averaged relevancy, M >= 1, row by row
    pixel: tuple[int, int]  # (x, y), the pixel of them nearest to their mean
    level: int  # position of the level chosen
    score: float  # the maximum, 0..1


@dataclass(frozen=True, eq=False)
class Segmentation:
    """The pixels that answer a query."""

    mask: Tensor  # [H, W] boolean
    level: int  # position of the level chosen
    score: float  # the largest smoothed relevancy at that level, 0..1


def localize(relevancy: Tensor, rule: MaskRule) -> Localization:
    """Return the most relevant place in one view, by the relevancy [S, H, W] to one query, 0..1.

    Each level is averaged by the rule's box; the level with the largest maximum is chosen, the first of equals,
    whatever the rule's ``level_choice``.
    """
    averaged = averaged_relevancy(relevancy, rule)
    peaks = averaged.flatten(1).amax(1)
    level = int(peaks.argmax())
    pixels = (averaged[level] == peaks[level]).nonzero().flip(1)
    # A pixel in the middle of a plateau says more than its first corner.
    offsets = pixels.double() - pixels.double().mean(0)
    x, y = pixels[int(offsets.square().sum(1).argmin())].tolist()
    return Localization(pixels, (x, y), level, float(peaks[level]))


def segment(relevancy: Tensor, rule: MaskRule) -> Segmentation:
    """Return the pixels of one view that answer a query; arguments as for ``localize``."""
    smoothed = 0.5 * (relevancy + averaged_relevancy(relevancy, rule))
    above = torch.stack([rescale(level) > rule.threshold for level in smoothed])
    masks = majority(above, rule.smoothing, rule.smoothing_border)
    level = choose_level(smoothed, masks, rule.level_choice)
    return Segmentation(masks[level], level, float(smoothed[level].max()))


def choose_level(smoothed: Tensor, masks: Tensor, choice: LevelChoice) -> int:
    """Return the position of the level that answers (step 4), by smoothed relevancy and boolean masks, both [S, H, W];
    the first of equals.

    With "mask", a level with an empty mask is never chosen, unless all are empty: then the peak decides.
    """
    areas = masks.flatten(1).sum(1)
    if choice == "peak" or not areas.any():
        return int(smoothed.flatten(1).amax(1).argmax())
    # float64, so that levels equal to the last bit have equal means.
    means = torch.where(masks, smoothed.double(), 0.0).flatten(1).sum(1) / areas
    return int(torch.where(areas > 0, means, -torch.inf).argmax())


def averaged_relevancy(relevancy: Tensor, rule: MaskRule) -> Tensor:
    """Return the means [S, H, W] of relevancy over the rule's box, which ``localize`` and ``segment`` both use."""
    if relevancy.dim() != 3 or 0 in relevancy.shape:
        raise InputError(
            f"relevancy of one query must be [S, H, W] and not empty, got {list(relevancy.shape)}"
        )
    return box_mean(relevancy, rule.kernel, rule.border)


def box_mean(maps: Tensor, kernel: int, border: Border = "inside") -> Tensor:
    """Return the mean over a kernel x kernel box around each pixel of maps [..., H, W], which may be smaller than it.

    The box of pixel x covers x - kernel // 2 ... x - kernel // 2 + kernel - 1 on each axis, as in OpenCV's filter2D for
    even kernels. Sums are float64, so that equal neighbourhoods have equal means.
    """
    means = maps.double()
    for axis in (-1, -2):
        means = _mean_along(means, axis, kernel, border)
    return means.to(maps.dtype)


def majority(masks: Tensor, side: int, border: VoteBorder = "inside") -> Tensor:
    """Return where most pixels of the box around each pixel of masks [S, H, W] are true; false for a tie.

    With the border "but last", the last row and column of the image have no vote (``smooth`` in LangSplat's
    ``eval/utils.py``); false without a vote.
    """
    if border == "inside":
        return box_mean(masks.float(), side) > 0.5
    voters = torch.zeros(masks.shape[-2:], device=masks.device)
    voters[:-1, :-1] = 1
    return 2 * box_mean(masks * voters, side) > box_mean(voters, side)


def rescale(values: Tensor) -> Tensor:
    """Stretch values of any shape to 0..1 and cut off the lower half: clip(2 n - 1, 0, 1) with
    n = (v - min) / (max - min + 1e-9) (step 2). Constant values become 0."""
    low, high = values.min(), values.max()
    # float64, in which 1e-9 does not vanish beside the range.
    stretched = (values.double() - low) / (high.double() - low + 1e-9)
    return (2 * stretched - 1).clamp(0, 1).to(values.dtype)


def _mean_along(values: Tensor, axis: int, kernel: int, border: Border) -> Tensor:
    """Running means along one axis of float64 values [..., H, W], by differences of running sums."""
    size = values.shape[axis]
    before, after = kernel // 2, kernel - 1 - kernel // 2
    counts: Tensor | int = kernel
    if border == "reflect":
        values = values.index_select(axis, _reflected(size, before, after).to(values.device))
        before = after = 0
    else:
        position = torch.arange(size, device=values.device)
        counts = (position + after).clamp(max=size - 1) - (position - before).clamp(min=0) + 1
        counts = counts.view([-1] + [1] * (-axis - 1))
    padding = [0, 0] * (-axis - 1) + [before + 1, after]
    sums = torch.nn.functional.pad(values, padding).cumsum(axis)
    return (sums.narrow(axis, kernel, size) - sums.narrow(axis, 0, size)) / counts


def _reflected(size: int, before: int, after: int) -> Tensor:
    """The source of each position from -before to size + after, mirrored at the edge pixels as often as needed."""
    positions = torch.arange(-before, size + after)
    period = max(2 * (size - 1), 1)
    positions = positions % period
    return torch.minimum(positions, period - positions) if size > 1 else torch.zeros_like(positions)
