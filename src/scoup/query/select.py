"""Gaussians that answer a query by their own codes, without rendering: the votes, in fields without things."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from scoup.base.brief import brief
from scoup.base.errors import InputError
from scoup.query.coded_scene import CodedScene
from scoup.query.cosines import FieldCodes, FieldCosines, versions
from scoup.query.question import Question
from scoup.query.selection import above_thresholds, rescale, stretched_counts
from scoup.query.stable_threshold import STABILITY, thresholds_of_counts

MOST_TEXTS, MOST_BYTES = 16, 192 << 20
"""So many texts are compared with all Gaussians at a time, if their relevancy fits into so many bytes: of a million
Gaussians at three levels, all of them."""
MOST_SAMPLED = 8192
"""Gaussians that stand for all where texts are compared with everyday words."""


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


def select_each(field: CodedScene, question: Question) -> Iterator[Selection]:
    """Yield the Gaussians that answer each text by the votes alone.

    One level answers each text: with a threshold that with the largest relevancy, as in VALA-3D; otherwise that whose
    selected Gaussians have the largest mean relevancy. Gaussians without a code at that level are never selected.
    """
    threshold, level = question.threshold, question.level
    if threshold is not None and not 0 <= threshold <= 1:
        raise InputError(f"the threshold must be 0 to 1, got {threshold}")
    rows = slice(None) if level is None else slice(level, level + 1)
    coded = field.coded_levels()[rows]  # [S or 1, N]
    at_a_time = min(MOST_TEXTS, max(1, MOST_BYTES // max(4 * coded.numel(), 1)))
    for some in question.queries.split(at_a_time):
        for relevancy in field.gaussian_relevancy(some, question.canonical)[rows].unbind(1):
            found = select_by_relevancy(relevancy, coded, threshold)
            yield replace(found, level=found.level + (level or 0))


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


def level_thresholds(values: Tensor, coded: Tensor) -> Tensor:
    """Return the most stable threshold of relevancy [S, N] rescaled over the coded Gaussians [S, N], [S] on the CPU."""
    return thresholds_of_counts(stretched_counts(values, coded, STABILITY.lowest_share)[1])


def _most_stable(values: Tensor, coded: Tensor) -> Selection:
    """Select by the most stable threshold of each level."""
    spans, counts = stretched_counts(values, coded, STABILITY.lowest_share)
    thresholds = thresholds_of_counts(counts)
    masks, areas, sums = above_thresholds(values, coded, spans, thresholds)
    peaks = spans[:, 1].tolist()
    means = torch.where(areas > 0, sums / areas, -torch.inf).tolist()
    order = means if bool(areas.any()) else peaks
    number = order.index(max(order))  # the first of levels alike
    return Selection(masks[number], values[number], number, float(thresholds[number]))


class SampledVotes:
    """Evenly chosen Gaussians of a field, of which texts and everyday words select some, to be compared.

    Args:
        field: without things, or asked by a threshold.
        question: its everyday words and canonical phrases are taken.
    """

    def __init__(self, field: CodedScene, question: Question) -> None:
        rows = true_rows(field.coded())
        rows = rows[:: max(1, -(-len(rows) // MOST_SAMPLED))]
        self._whole = field.code_indices, field.code_weights  # kept, so that no other tensor gets their ids
        self._codes = FieldCodes(field.code_indices[rows], field.code_weights[rows], field.codebook)
        self._canonical = question.canonical.to(field.codebook.device)
        self._cosines = FieldCosines()
        self.best_fits = self.fits(question.everyday)

    @staticmethod
    def key(field: CodedScene, question: Question) -> tuple[object, ...]:
        """Return what these votes depend on."""
        tensors = field.code_indices, field.code_weights, field.codebook
        words = question.everyday, question.canonical
        return ("votes", *versions(*tensors), *(each.cpu().numpy().tobytes() for each in words))

    def fits(self, queries: Tensor) -> Tensor:
        """Return the fit [Q] of each text [Q, D] (``Selection.fit``)."""
        coded, found = self._cosines.coded(self._codes), []
        for some in queries.to(self._canonical).split(MOST_TEXTS):
            relevancy = self._cosines.of_gaussians(self._codes, some, self._canonical)
            found += [select_by_relevancy(each, coded).fit for each in relevancy.unbind(1)]
        return torch.tensor(found)
