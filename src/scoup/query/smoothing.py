"""Box means of maps, masks of relevancy (docs/protocols.md, LERF-OVS, steps 1 to 3), and the parts of masks.

The compiled core finds the parts; ``plain_mask_parts`` is its specification, used without the core.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from scoup.base.native import native_core

Border = Literal["inside", "reflect"]
VoteBorder = Literal["inside", "but last"]


def box_mean(maps: Tensor, kernel: int, border: Border = "inside") -> Tensor:
    """Return the mean over a kernel x kernel box around each pixel, same size as the input.

    The box of pixel x covers x - kernel // 2 ... x - kernel // 2 + kernel - 1 on each axis, as in OpenCV's filter2D for
    even kernels. Sums are float64, so that equal neighbourhoods have equal means.

    Args:
        maps: [..., H, W] floating point; may be smaller than the kernel.
        kernel: side of the box in pixels.
        border: see ``QueryPreset``.
    """
    means = maps.double()
    for axis in (-1, -2):
        means = _mean_along(means, axis, kernel, border)
    return means.to(maps.dtype)


def smoothed_masks(
    relevancy: Tensor, averaged: Tensor, thresholds: Tensor, smoothing: int, border: VoteBorder = "inside"
) -> tuple[Tensor, Tensor]:
    """Return smoothed relevancy, and the majority of pixels above the threshold on it, rescaled.

    Args:
        relevancy: [S, H, W] of one query, not empty.
        averaged: [S, H, W] its ``box_mean``.
        thresholds: [S] float32 on the CPU.
        smoothing, border: see ``smoothing`` and ``smoothing_border`` of ``QueryPreset``.

    Returns:
        smoothed relevancy [S, H, W], dtype of ``relevancy``, and masks [S, H, W] boolean.
    """
    if border == "but last":
        smoothed, above = smoothed_masks(relevancy, averaged, thresholds, 1)
        return smoothed, majority_but_last(above, smoothing)
    smoothed = 0.5 * (relevancy + averaged)
    above = torch.stack(
        [rescale(level) > threshold for level, threshold in zip(smoothed, thresholds.tolist(), strict=True)]
    )
    return smoothed, box_mean(above.float(), smoothing) > 0.5


def majority_but_last(masks: Tensor, side: int) -> Tensor:
    """Return whether most pixels of the box around each pixel of masks [S, H, W] are true, without votes of the last
    row and column of the image (``smooth`` in LangSplat's ``eval/utils.py``); false for a tie and without a vote.
    """
    voters = torch.zeros(masks.shape[-2:], device=masks.device)
    voters[:-1, :-1] = 1
    return 2 * box_mean(masks * voters, side) > box_mean(voters, side)


def mask_sums(smoothed: Tensor, masks: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return the largest smoothed relevancy of each level [S], the pixels of its mask [S] int64, and the sum of
    smoothed relevancy over them [S] float64, so that levels equal to the last bit have equal means.
    """
    sums = torch.where(masks, smoothed.double(), 0.0).flatten(1).sum(1)
    return smoothed.flatten(1).amax(1), masks.flatten(1).sum(1), sums


def mask_parts(mask: NDArray[np.bool_]) -> tuple[NDArray[np.int32], int]:
    """Return the connected part of each pixel of a mask [H, W], 0 outside, and how many parts there are.

    Pixels that touch at a corner are connected. Parts are numbered from 1 by their first pixels, row by row.
    """
    core = native_core()
    if core is None:
        return plain_mask_parts(mask)
    return core.mask_parts(np.ascontiguousarray(mask).view(np.uint8))


def plain_mask_parts(mask: NDArray[np.bool_]) -> tuple[NDArray[np.int32], int]:
    """``mask_parts`` by scipy, which takes half a second to import."""
    from scipy import ndimage

    parts = np.empty(mask.shape, np.int32)
    count = int(ndimage.label(mask, np.ones((3, 3)), output=parts))  # pyright: ignore[reportArgumentType]
    return parts, count


def rescale(values: Tensor, low: Tensor | None = None, high: Tensor | None = None) -> Tensor:
    """Stretch values of any shape to 0..1 and cut off the lower half: clip(2 n - 1, 0, 1) with
    n = (v - min) / (max - min + 1e-9) (protocols.md, LERF-OVS, step 2). Constant values become 0.

    Pass minimum and maximum where these are only some of the values."""
    low = values.min() if low is None else low
    high = values.max() if high is None else high
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
