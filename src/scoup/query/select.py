"""Gaussians that answer a query by their own codes, without rendering (docs/protocols.md, "3D selection")."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from scoup.base.brief import brief
from scoup.base.errors import InputError
from scoup.query.coded_scene import CodedScene
from scoup.query.selection import above_thresholds, stretched_counts
from scoup.query.smoothing import rescale
from scoup.query.stable_threshold import STABILITY, thresholds_of_counts
from scoup.scene.neighbours import Neighbourhood

ABSOLUTE_THRESHOLD = 0.6
"""Default threshold on relevancy that is not rescaled. The most stable one nearly always selects something, but here
nothing is to be selected where nothing is relevant enough."""

MOST_TEXTS, MOST_BYTES = 16, 192 << 20
"""So many texts are compared with all Gaussians at a time, if their relevancy fits into so many bytes: of a million
Gaussians at three levels, all of them."""


@dataclass(frozen=True, eq=False)
class Selection:
    """The Gaussians that one query selects."""

    mask: Tensor  # [N] boolean
    relevancy: Tensor  # [N] float32 at the level chosen, after blending with neighbours
    level: int  # position of the level chosen
    score: float  # the largest relevancy of a Gaussian with a code at that level; minus infinity if there is none
    threshold: float | None  # see ``SceneAnswer``
    of_levels: Tensor | None = (
        None  # [S or 1, N] relevancy at all levels that could be chosen, before blending
    )

    __repr__ = brief


def true_rows(mask: Tensor) -> Tensor:
    """Return where a boolean mask [N] is true, [M] int64. Numpy finds few among many faster than torch."""
    if mask.device.type != "cpu":
        return mask.nonzero()[:, 0]
    return torch.from_numpy(np.flatnonzero(mask.numpy()))


def select_each(
    field: CodedScene,
    queries: Tensor | ArrayLike,  # [Q, D]
    canonical: Tensor | ArrayLike,  # [P, D]
    threshold: float | None = None,
    neighbours: int | None = None,
    rescaled: bool = True,
    level: str | int | None = None,
) -> Iterator[Selection]:
    """Yield the Gaussians that answer each of several queries, by the votes alone.

    One level answers each query, after blending with neighbours (10 in VALA-3D). With a threshold, it is the level with
    the largest relevancy, as in VALA-3D; otherwise that whose selected Gaussians have the largest mean relevancy.
    Gaussians without a code at that level are never selected.

    Args:
        field: the language field; its geometry is needed only for ``neighbours``.
        queries: [Q, D] unit-norm text embeddings.
        canonical: [P, D] unit-norm embeddings of the canonical phrases.
        threshold, neighbours, rescaled, level: see ``scoup.query.question.Question``. Without a threshold, and not
            rescaled, it is ``ABSOLUTE_THRESHOLD``.
    """
    if neighbours is not None and neighbours < 1:
        raise InputError(f"neighbours must be at least 1, got {neighbours}")
    if threshold is not None and not 0 <= threshold <= 1:
        raise InputError(f"the threshold must be 0 to 1, got {threshold}")
    first = 0 if level is None else field.level_index(level)
    rows = slice(None) if level is None else slice(first, first + 1)
    coded = field.coded_levels()[rows]  # [S or 1, N]
    around = Neighbourhood.of(field.gaussians.means, coded.any(0), neighbours) if neighbours else None
    at_a_time = min(MOST_TEXTS, max(1, MOST_BYTES // max(4 * coded.numel(), 1)))
    queries = torch.as_tensor(queries)
    for start in range(0, len(queries), at_a_time):
        some = queries[start : start + at_a_time]
        for relevancy in field.gaussian_relevancy(some, canonical)[rows].unbind(1):
            found = select_by_relevancy(relevancy, coded, around, threshold, rescaled)
            yield replace(found, level=found.level + first, of_levels=relevancy)


def select_by_relevancy(
    relevancy: Tensor,  # [S, N]
    coded: Tensor,  # [S, N]
    around: Neighbourhood | None = None,
    threshold: float | None = None,
    rescaled: bool = True,
) -> Selection:
    """Select by the relevancy of one query among coded Gaussians, as ``select_each`` does."""
    values = relevancy if around is None else around.blend(relevancy, coded)
    if threshold is None and rescaled:
        return _most_stable(values, coded)
    masked = torch.where(coded, values, -torch.inf)
    peaks = masked.amax(1) if masked.shape[1] else masked.new_full((len(masked),), -torch.inf)
    threshold = ABSOLUTE_THRESHOLD if threshold is None else threshold
    level = int(peaks.argmax())
    mask = _above(values[level], coded[level], threshold, rescaled)
    return Selection(mask, values[level], level, float(peaks[level]), float(threshold))


def level_thresholds(values: Tensor, coded: Tensor) -> Tensor:
    """Return the most stable threshold of relevancy [S, N] rescaled over the coded Gaussians [S, N], [S] on the CPU."""
    return thresholds_of_counts(stretched_counts(values, coded, STABILITY.lowest_share)[1])[0]


def _most_stable(values: Tensor, coded: Tensor) -> Selection:
    """Select by the most stable threshold of each level."""
    spans, counts = stretched_counts(values, coded, STABILITY.lowest_share)
    thresholds = thresholds_of_counts(counts)[0]
    masks, areas, sums = above_thresholds(values, coded, spans, thresholds)
    peaks = spans[:, 1].tolist()
    means = torch.where(areas > 0, sums / areas, -torch.inf).tolist()
    order = means if bool(areas.any()) else peaks
    number = order.index(max(order))  # the first of levels alike
    return Selection(masks[number], values[number], number, peaks[number], float(thresholds[number]))


def _above(values: Tensor, members: Tensor, threshold: float, rescaled: bool = True) -> Tensor:
    """The members [N] whose value [N], perhaps rescaled over them, is above the threshold, [N] boolean."""
    mask = torch.zeros_like(members)
    if members.any():
        candidates = values[members]
        mask[members] = (rescale(candidates) if rescaled else candidates) > threshold
    return mask
