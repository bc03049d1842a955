"""Relevancy stretched over a row, counted by hundredths, and compared with a threshold.

The compiled core does it on a CPU. The torch code (``plain_...``) is its specification, and is used without the core,
on other devices and for other types; counts and masks are the same to the last bit.
"""

from __future__ import annotations

from types import ModuleType

import numpy as np
import torch
from torch import Tensor

from scoup.base.native import native_core

BINS = 100


def stretched_counts(values: Tensor, included: Tensor | None, share: float) -> tuple[Tensor, Tensor]:
    """Return the span of each row, and how many of its values are in each hundredth once rescaled over it.

    Args:
        values: [S, M] floating point.
        included: [S, M] boolean, those that count; None: all.
        share: values below this share of the span need not be counted.

    Returns:
        spans [S, 2], the smallest and the largest value, infinity and minus infinity without any; and counts
        [S, ``BINS``] int64, zeros for a row that is empty or not finite. Both on the CPU.
    """
    core = _core_for(values)
    if core is None:
        return plain_stretched_counts(values, included, share)
    found = core.count_stretched(_rows(values), _bytes(included), share, torch.get_num_threads())
    return torch.from_numpy(found[0]), torch.from_numpy(found[1])


def plain_stretched_counts(values: Tensor, included: Tensor | None, share: float) -> tuple[Tensor, Tensor]:
    """``stretched_counts`` in torch."""
    spans, counts = [], []
    for number, row in enumerate(values):
        own = row if included is None else row[included[number]]
        ends = torch.stack(own.aminmax()) if own.numel() else own.new_tensor([torch.inf, -torch.inf])
        low, high = ends
        bins = torch.zeros(BINS, dtype=torch.float64)
        if ends.isfinite().all():
            # A little lower than needed, for rounding.
            counted = own[own >= low + (high - low) * share - 1e-6]
            bins = torch.histc(rescale(counted, low, high).float(), BINS, 0, 1).double().cpu()
        spans.append(ends.cpu())
        counts.append(bins.long())
    if not counts:
        return values.new_zeros(0, 2).cpu(), torch.zeros(0, BINS, dtype=torch.int64)
    return torch.stack(spans), torch.stack(counts)


def above_thresholds(
    values: Tensor, included: Tensor | None, spans: Tensor, thresholds: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Return which values of each row are above its threshold once rescaled, how many, and their sum.

    Args:
        values, included: as for ``stretched_counts``.
        spans: [S, 2] from there.
        thresholds: [S] float32 on the CPU.

    Returns:
        masks [S, M] boolean, counts [S] int64 and sums [S] float64, in which rows alike to the last bit are equal.
        Counts and sums are on the CPU.
    """
    core = _core_for(values)
    if core is None:
        return plain_above_thresholds(values, included, spans, thresholds)
    found = core.above_thresholds(
        _rows(values), _bytes(included), spans.numpy(), thresholds.numpy(), torch.get_num_threads()
    )
    masks, counts, sums = (torch.from_numpy(each) for each in found)
    return masks.view(torch.bool), counts, sums


def plain_above_thresholds(
    values: Tensor, included: Tensor | None, spans: Tensor, thresholds: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """``above_thresholds`` in torch."""
    masks = torch.zeros(values.shape, dtype=torch.bool, device=values.device)
    for number, (ends, threshold) in enumerate(
        zip(spans.to(values.device), thresholds.tolist(), strict=True)
    ):
        if ends.isfinite().all():
            masks[number] = rescale(values[number], ends[0], ends[1]) > threshold
    masks = masks if included is None else masks & included
    sums = torch.stack([row[mask].double().sum() for row, mask in zip(values, masks, strict=True)])
    return masks, masks.sum(1).cpu(), sums.cpu()


def _core_for(values: Tensor) -> ModuleType | None:
    return native_core() if values.device.type == "cpu" and values.dtype == torch.float32 else None


def _rows(values: Tensor) -> np.ndarray:
    return values.detach().contiguous().numpy()


def _bytes(included: Tensor | None) -> np.ndarray | None:
    return None if included is None else included.contiguous().view(torch.uint8).numpy()


def rescale(values: Tensor, low: Tensor | None = None, high: Tensor | None = None) -> Tensor:
    """Stretch values of any shape to 0..1 and cut off the lower half: clip(2 n - 1, 0, 1) with
    n = (v - min) / (max - min + 1e-9) (docs/evaluation.md, step 2). Constant values become 0.

    Pass minimum and maximum where these are only some of the values."""
    low = values.min() if low is None else low
    high = values.max() if high is None else high
    # float64, in which 1e-9 does not vanish beside the range.
    stretched = (values.double() - low) / (high.double() - low + 1e-9)
    return (2 * stretched - 1).clamp(0, 1).to(values.dtype)
