"""The votes: Gaussians that answer a text by their own codes, without rendering, in fields without things.

The papers fix one threshold per data set (0.6, 0.3, 0.45). Where a thing stands out, relevancy falls steeply at its
border, and the area above a threshold hardly depends on it. So the threshold is the one at which the logarithm of that
area changes least over a window, like maximally stable extremal regions of pictures (Matas, Chum, Urban and Pajdla
2002). Measured in docs/answers.md.

The compiled core counts and compares on a CPU. The torch code (``plain_...``) is its specification, and is used without
the core, on other devices and for other types; counts and masks are the same to the last bit.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from types import ModuleType

import numpy as np
import torch
from torch import Tensor

from scoup.base import brief, native_core
from scoup.field import Field
from scoup.query import constants
from scoup.query.question import Question

BINS = 100
MOST_TEXTS, MOST_BYTES = 16, 192 << 20
"""So many texts are compared with all Gaussians at a time, if their relevancy fits into so many bytes: of a million
Gaussians at three levels, all of them."""


@dataclass(frozen=True, eq=False)
class Selection:
    """The Gaussians that one query selects."""

    mask: Tensor  # [N] boolean
    relevancy: Tensor  # [N] float32 at the level chosen
    level: int  # position of the level chosen
    threshold: float  # on the relevancy rescaled over the Gaussians with a code at that level

    __repr__ = brief

    @property
    def fit(self) -> float:
        """The mean relevancy of what is selected; minus infinity if nothing is."""
        return float(self.relevancy[self.mask].mean()) if bool(self.mask.any()) else -torch.inf


def true_rows(mask: Tensor) -> Tensor:
    """Return where a boolean mask [N] is true, [M] int64. Numpy finds few among many faster than torch."""
    if mask.device.type != "cpu":
        return mask.nonzero()[:, 0]
    return torch.from_numpy(np.flatnonzero(mask.numpy()))


def select_each(field: Field, question: Question) -> Iterator[Selection]:
    """Yield the Gaussians that answer each text by the votes alone.

    One level answers each text: with a threshold, the level of the largest relevancy, as in VALA-3D; otherwise the one
    whose selected Gaussians have the largest mean relevancy. Gaussians without a code there are never selected.
    """
    threshold, level = question.threshold, question.level
    rows = slice(None) if level is None else slice(level, level + 1)
    coded = field.coded_levels()[rows]  # [S or 1, N]
    at_a_time = min(MOST_TEXTS, max(1, MOST_BYTES // max(4 * coded.numel(), 1)))
    for some in question.queries.split(at_a_time):
        for relevancy in field.gaussian_relevancy(some, question.canonical)[rows].unbind(1):
            selection = select_by_relevancy(relevancy, coded, threshold)
            yield replace(selection, level=selection.level + (level or 0))


def select_by_relevancy(
    relevancy: Tensor,  # [S, N]
    coded: Tensor,  # [S, N]
    threshold: float | None = None,
) -> Selection:
    """Select by the relevancy of one query among coded Gaussians, as ``select_each`` does."""
    if threshold is None:
        return _most_stable(relevancy, coded)
    masked = torch.where(coded, relevancy, -torch.inf)
    peaks = masked.amax(1) if masked.shape[1] else masked.new_full((len(masked),), -torch.inf)
    level = int(peaks.argmax())
    mask = torch.zeros_like(coded[level])
    if coded[level].any():
        mask[coded[level]] = rescale(relevancy[level][coded[level]]) > threshold
    return Selection(mask, relevancy[level], level, float(threshold))


def level_thresholds(values: Tensor, coded: Tensor) -> tuple[Tensor, Tensor]:
    """Return the most stable threshold [S] of relevancy [S, N] rescaled over the coded Gaussians [S, N], and the
    relevancies [S, 2] that rescaling takes to 0 and to 1, 0.5 and 0.5 for a level without any; on the CPU."""
    ends, counts = stretched_counts(values, coded)
    spans = torch.stack([ends.mean(1), ends[:, 1]], 1)  # the lower half is cut off
    return thresholds_of_counts(counts), torch.where(coded.any(1)[:, None].cpu(), spans, 0.5)


def _most_stable(values: Tensor, coded: Tensor) -> Selection:
    """Select by the most stable threshold of each level."""
    spans, counts = stretched_counts(values, coded)
    thresholds = thresholds_of_counts(counts)
    masks, areas, sums = above_thresholds(values, coded, spans, thresholds)
    peaks = spans[:, 1].tolist()
    means = torch.where(areas > 0, sums / areas, -torch.inf).tolist()
    order = means if bool(areas.any()) else peaks
    number = order.index(max(order))  # the first of equals
    return Selection(masks[number], values[number], number, float(thresholds[number]))


class SampledVotes:
    """An even sample of a field's Gaussians, to compare texts and a question's everyday words by the Gaussians they
    select."""

    def __init__(self, field: Field, question: Question) -> None:
        rows = true_rows(field.coded())
        rows = rows[:: max(1, -(-len(rows) // constants.MOST_SAMPLED))]
        codes = field.codes.rows(rows)
        canonical = question.canonical.to(field.codebook.device)
        self._coded = codes.coded()
        self._cosines = codes.cosines(canonical, codes.inverse_norms())
        self.best_fits = self.fits(question.everyday)

    @property
    def nbytes(self) -> int:
        """Bytes of the fits."""
        return self.best_fits.nbytes

    def fits(self, queries: Tensor) -> Tensor:
        """Return the fit [Q] of each text [Q, D] (``Selection.fit``)."""
        fits = []
        for some in queries.to(self._cosines.codes.codebook).split(MOST_TEXTS):
            relevancy = self._cosines.relevancy(some)
            fits += [select_by_relevancy(of_text, self._coded).fit for of_text in relevancy.unbind(1)]
        return torch.tensor(fits)


def thresholds_of_counts(counts: Tensor) -> Tensor:
    """Return the most stable threshold [S] float32 on the rescaled relevancy, on the CPU, from ``stretched_counts`` [S,
    ``BINS``]. Rows that are empty, constant or not finite have the centre."""
    above = counts.double().flip(1).cumsum(1).flip(1)  # values in bin b and further up
    area = above.clamp(min=1).log()
    half = round(constants.WINDOW / 2 * BINS)
    bins = torch.arange(round(constants.LOWEST * BINS), round(constants.HIGHEST * BINS) + 1)
    bins = bins[(bins >= half) & (bins < BINS - half)]
    change = area[:, bins - half] - area[:, bins + half]
    at = bins / BINS
    best = (change + constants.PULL * (at - constants.CENTRE).abs()).argmin(1)
    return at[best].float()


def stretched_counts(values: Tensor, coded: Tensor) -> tuple[Tensor, Tensor]:
    """Return the span of each row, and the number of its values in each hundredth once rescaled over it.

    Args:
        values: [S, M] floating point.
        coded: [S, M] boolean, those that count.

    Returns:
        spans [S, 2], the smallest and the largest value, infinity and minus infinity without any; and counts
        [S, ``BINS``] int64, of values from ``lowest_share`` of the span on, zeros for a row that is empty or not
        finite. Both on the CPU.
    """
    core = _core_for(values)
    if core is None:
        return plain_stretched_counts(values, coded)
    counted = core.count_stretched(_rows(values), _bytes(coded), lowest_share(), torch.get_num_threads())
    return torch.from_numpy(counted[0]), torch.from_numpy(counted[1])


def plain_stretched_counts(values: Tensor, coded: Tensor) -> tuple[Tensor, Tensor]:
    """``stretched_counts`` in torch."""
    spans, counts = torch.zeros(len(values), 2, dtype=values.dtype), torch.zeros(len(values), BINS).long()
    for number, (row, is_coded) in enumerate(zip(values, coded, strict=True)):
        row = row[is_coded]
        low, high = row.aminmax() if len(row) else row.new_tensor([torch.inf, -torch.inf])
        spans[number] = torch.stack([low, high])
        if spans[number].isfinite().all():
            # A little lower than needed, for rounding.
            counted = row[row >= low + (high - low) * lowest_share() - 1e-6]
            for batch in rescale(counted, low, high).float().split(1 << 24):  # float32 counts no further
                counts[number] += torch.histc(batch, BINS, 0, 1).cpu().long()
    return spans, counts


def above_thresholds(
    values: Tensor, coded: Tensor, spans: Tensor, thresholds: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Return masks of the values of each row above its threshold once rescaled, their number and their sum.

    Args:
        values, coded: as for ``stretched_counts``.
        spans: [S, 2] from there.
        thresholds: [S] float32 on the CPU.

    Returns:
        masks [S, M] boolean, counts [S] int64 and sums [S] float64, in which rows alike to the last bit are equal.
        Counts and sums are on the CPU.
    """
    core = _core_for(values)
    if core is None:
        return plain_above_thresholds(values, coded, spans, thresholds)
    result = core.above_thresholds(
        _rows(values), _bytes(coded), spans.numpy(), thresholds.numpy(), torch.get_num_threads()
    )
    masks, counts, sums = (torch.from_numpy(array) for array in result)
    return masks.view(torch.bool), counts, sums


def plain_above_thresholds(
    values: Tensor, coded: Tensor, spans: Tensor, thresholds: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """``above_thresholds`` in torch."""
    masks, spans = torch.zeros_like(coded), spans.to(values.device)
    for number, threshold in enumerate(thresholds.tolist()):
        if spans[number].isfinite().all():
            masks[number] = coded[number] & (rescale(values[number], *spans[number]) > threshold)
    sums = torch.stack([row[mask].double().sum() for row, mask in zip(values, masks, strict=True)])
    return masks, masks.sum(1).cpu(), sums.cpu()


def lowest_share() -> float:
    """Return the share of the span, before rescaling, where the lowest window begins; lower values do not count."""
    return 0.5 + 0.5 * (constants.LOWEST - constants.WINDOW / 2)


def _core_for(values: Tensor) -> ModuleType | None:
    return native_core() if values.device.type == "cpu" and values.dtype == torch.float32 else None


def _rows(values: Tensor) -> np.ndarray:
    return values.detach().contiguous().numpy()


def _bytes(coded: Tensor) -> np.ndarray:
    return coded.contiguous().view(torch.uint8).numpy()


def rescale(values: Tensor, low: Tensor | None = None, high: Tensor | None = None) -> Tensor:
    """Stretch values of any shape to 0..1 and cut off the lower half: clip(2 n - 1, 0, 1) with
    n = (v - min) / (max - min + 1e-9) (docs/evaluation.md). Constant values become 0.

    Pass minimum and maximum where these are only some of the values."""
    low = values.min() if low is None else low
    high = values.max() if high is None else high
    # float64, in which 1e-9 does not vanish beside the range.
    stretched = (values.double() - low) / (high.double() - low + 1e-9)
    return (2 * stretched - 1).clamp(0, 1).to(values.dtype)
