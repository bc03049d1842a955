"""Things without training: regions of many views that the same Gaussians contribute to are one instance.

Two regions r of view a and q of view b overlap by I = sum over Gaussians of sqrt(A_ir A_iq). Each can overlap only as
far as the other view sees it: D_rb = sum of sqrt(A_ir V_ib), where V_ib is what Gaussian i contributes to all regions
of view b. So IoU = I / (D_rb + D_qa - I). Regions of one level merge best pair first. Clusters are compared by the same
ratio of sums over all pairs of regions from different views (average linkage, weighed by mass), down to ``LEAST_IOU``.
Own; measured in docs/answers.md.

Square roots are rounded to whole numbers, so every sum is exact, in any order. Regions are taken by the names of their
views. So the same views give the same things, whether they were added at once, one by one, or by shards.
"""

from __future__ import annotations

import heapq
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from scoup.base.processes import ALONE, Processes
from scoup.base.progress import Progress, no_progress
from scoup.scene.directions import normalise_embeddings
from scoup.scene.things import MOST_THINGS, NO_THING, Things
from scoup.uplift.region_sums import RegionSums

Matrix = Any
"""A scipy CSR array, which type checkers know little of."""

LEAST_IOU = 0.3
"""Clusters that overlap less are different things."""
LEAST_OVERLAP = 0.05
"""Pairs of regions with a smaller IoU count as apart: they touch, or one bleeds into the other."""
LEAST_SHARE = 0.05
"""Entries below this share of a Gaussian's largest say nothing about what it is part of."""
MASS = 0.98
"""The Gaussians that contribute this much of everything, the largest contributors first, decide what is merged."""
LEAST_REGIONS = 2
"""A region that no other view confirms is no thing."""
ROOT_STEPS = 64.0
"""Whole numbers that stand for a square root of 1 pixel."""
INSIDE = 0.5
"""Share of a thing that its parent must own."""


def find_things(
    sums: RegionSums,
    embeddings: Sequence[Tensor],
    processes: Processes = ALONE,
    progress: Progress = no_progress,
) -> Things:
    """Merge the regions of all views into things.

    Args:
        sums: of the views, with the rows of their regions among the embeddings (``RegionSums.of_views``); on each of
            several processes those of some of the Gaussians.
        embeddings: per level [R, D], of the regions of all views. They do not decide what is merged.
        processes: all that hold a part of the sums.
        progress: called for the stage "things".
    """
    assert sums.rows is not None
    entries = _gathered(_strong_entries(sums), processes)
    found: list[_LevelThings] = []
    for number, (rows, of_level) in enumerate(zip(sums.rows, embeddings, strict=True)):
        progress("things", number, len(embeddings))
        matrix = _by_region(entries, number, rows)
        found.append(
            _things_of_level(matrix, rows, of_level, entries.decides, MOST_THINGS // len(embeddings))
        )
    progress("things", len(embeddings), len(embeddings))
    return _joined(found, sums, entries.total)


@dataclass(frozen=True, eq=False)
class _StrongEntries:
    """What Gaussians contribute to regions, without what is weak.

    Attributes:
        gaussians: [E] int32 in the order of the sums.
        regions: [E, S] int32, rows of the regions among those of all views; -1 for none.
        weights: [E] float32.
        total: [N] float64, of each Gaussian over all views.
        decides: [N] boolean, the Gaussians that decide what is merged.
    """

    gaussians: NDArray[np.int32]
    regions: NDArray[np.int32]
    weights: NDArray[np.float32]
    total: NDArray[np.float64]
    decides: NDArray[np.bool_]


def _strong_entries(sums: RegionSums) -> _StrongEntries:
    count = sums.n_gaussians
    assert sums.rows is not None
    total, largest = np.zeros(count), np.zeros(count, np.float32)
    names = sorted(sums.rows[0])
    for name in names:
        for part in sums.views[name].parts:
            part.check_numbers(count)
            gaussians, weights = part.gaussians(), part.weights.astype(np.float32)
            starts = np.flatnonzero(np.diff(gaussians, prepend=-1))
            if len(starts):
                each = gaussians[starts]
                total[each] += np.add.reduceat(weights.astype(np.float64), starts)
                largest[each] = np.maximum(largest[each], np.maximum.reduceat(weights, starts))
    kept: list[tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.float32]]] = []
    for name in names:
        firsts = np.array([rows[name].start for rows in sums.rows])
        for part in sums.views[name].parts:
            gaussians, weights = part.gaussians(), part.weights.astype(np.float32)
            strong = np.flatnonzero((weights >= LEAST_SHARE * largest[gaussians]) & (weights > 0))
            table = np.where(part.table >= 0, part.table + firsts, -1).astype(np.int32)
            kept.append(
                (gaussians[strong].astype(np.int32), table[part.combinations[strong]], weights[strong])
            )
    if not kept:
        kept = [(np.zeros(0, np.int32), np.zeros((0, len(sums.rows)), np.int32), np.zeros(0, np.float32))]
    gaussians, regions, weights = (np.concatenate(parts) for parts in zip(*kept, strict=True))
    return _StrongEntries(gaussians, regions, weights, total, np.zeros(count, bool))


def _gathered(entries: _StrongEntries, processes: Processes) -> _StrongEntries:
    """The entries of all processes, each of which holds those of some Gaussians; and which Gaussians decide."""
    parts = processes.gather(entries)
    total = sum((part.total for part in parts[1:]), parts[0].total)
    order = np.argsort(-total, kind="stable")
    mass = np.cumsum(total[order])
    decides = np.zeros(len(total), bool)
    if len(mass) and mass[-1] > 0:
        decides[order[: int(np.searchsorted(mass, MASS * mass[-1])) + 1]] = True
    arrays = ("gaussians", "regions", "weights")
    joined = {name: np.concatenate([getattr(part, name) for part in parts]) for name in arrays}
    return _StrongEntries(**joined, total=total, decides=decides)


def _by_region(entries: _StrongEntries, level: int, rows: Mapping[str, slice]) -> Matrix:
    """[N, R] float32 of one level; R in the order of the rows."""
    from scipy.sparse import coo_array

    n_regions = max((part.stop for part in rows.values()), default=0)
    region = entries.regions[:, level]
    there = region >= 0
    places = (entries.gaussians[there], region[there])
    shape = (len(entries.total), n_regions)
    matrix = coo_array((entries.weights[there], places), shape).tocsr()
    matrix.sum_duplicates()
    return matrix


@dataclass(frozen=True, eq=False)
class _LevelThings:
    """The things of one level, largest first.

    Attributes:
        owners: [N] int64, -1 for none.
        embeddings: [T, D] float32.
        agreement, mass: [T] float32.
        n_regions: [T] int32.
    """

    owners: NDArray[np.int64]
    embeddings: NDArray[np.float32]
    agreement: NDArray[np.float32]
    n_regions: NDArray[np.int32]


def _things_of_level(
    matrix: Matrix, rows: Mapping[str, slice], embeddings: Tensor, decides: NDArray[np.bool_], most: int
) -> _LevelThings:
    count = matrix.shape[1]
    order, views = np.zeros(0, np.int64), np.zeros(0, np.int64)
    for number, name in enumerate(sorted(rows)):
        mine = np.arange(rows[name].start, rows[name].stop)
        order, views = np.append(order, mine), np.append(views, np.full(len(mine), number))
    labels = np.full(count, -1)
    labels[order] = merge_regions(matrix[decides][:, order], views)
    sizes = np.bincount(labels[order], minlength=1)
    mass = np.bincount(labels[order], np.asarray(matrix.sum(0)).ravel()[order], len(sizes))
    things = np.flatnonzero((sizes >= LEAST_REGIONS) & (mass > 0))
    things = things[np.argsort(-mass[things], kind="stable")][:most]
    place = np.full(len(sizes), -1)
    place[things] = np.arange(len(things))
    member = np.where(labels >= 0, place[labels], -1)  # [R] thing of each region
    region_mass = np.asarray(matrix.sum(0)).ravel()
    means, agreement = mean_embeddings(embeddings, member, region_mass, len(things))
    return _LevelThings(
        _owners(matrix, member, len(things)), means, agreement, sizes[things].astype(np.int32)
    )


def merge_regions(
    matrix: Matrix, views: NDArray[np.int64], least_iou: float = LEAST_IOU
) -> NDArray[np.int64]:
    """The cluster of every region.

    Args:
        matrix: [N, R] float32, what each Gaussian contributes to each region of one level.
        views: [R] the view of each region, from 0.
        least_iou: clusters that overlap less stay apart.

    Returns:
        [R] int64, from 0; clusters in the order of their first regions.
    """
    from scipy.sparse import csr_array

    count = len(views)
    if not count:
        return np.zeros(0, np.int64)
    n_views = int(views.max()) + 1
    one_hot = csr_array((np.ones(count), (np.arange(count), views)), (count, n_views))
    # Whole numbers below 2^53 in float64: exact sums.
    root: Matrix = matrix.astype(np.float64)
    seen: Matrix = (root @ one_hot).tocsr()
    root.data, seen.data = (np.rint(ROOT_STEPS * np.sqrt(part.data)) for part in (root, seen))
    overlap = (root.T.tocsr() @ root).tocoo()
    reach = (root.T @ seen).toarray()  # D
    first, second = overlap.coords
    above = (first < second) & (views[first] != views[second])
    first, second, overlaps = first[above], second[above], overlap.data[above]
    union = reach[first, views[second]] + reach[second, views[first]] - overlaps
    keep = overlaps > LEAST_OVERLAP * union
    pairs = np.stack([first[keep], second[keep]], 1)
    return _agglomerate(pairs, overlaps[keep], reach, views, least_iou)


def _agglomerate(
    pairs: NDArray[np.int64],  # [P, 2]
    overlaps: NDArray[np.float64],  # [P]
    reach: NDArray[np.float64],  # [R, V], changed
    views: NDArray[np.int64],  # [R]
    least_iou: float,
) -> NDArray[np.int64]:
    """Best pair first, by a heap; an entry of it is stale once one of the two has grown."""
    count = len(views)
    near: list[dict[int, float]] = [{} for _ in range(count)]
    for (one, other), overlap in zip(pairs.tolist(), overlaps.tolist(), strict=True):
        near[one][other] = near[other][one] = overlap
    seen_in = np.zeros_like(reach)
    seen_in[np.arange(count), views] = 1
    grown, parent = [0] * count, list(range(count))
    unions = reach[pairs[:, 0], views[pairs[:, 1]]] + reach[pairs[:, 1], views[pairs[:, 0]]] - overlaps
    ious = overlaps / np.maximum(unions, 1)
    above = ious > least_iou
    heap = [
        (-iou, a, b, 0, 0) for iou, (a, b) in zip(ious[above].tolist(), pairs[above].tolist(), strict=True)
    ]
    heapq.heapify(heap)
    while heap:
        _, one, other, *ages = heapq.heappop(heap)
        if parent[one] != one or parent[other] != other or ages != [grown[one], grown[other]]:
            continue
        parent[other] = one
        grown[one] += 1
        reach[one] += reach[other]
        seen_in[one] += seen_in[other]
        mine = near[one]
        del mine[other]
        for third, overlap in near[other].items():
            if third != one:
                mine[third] = mine.get(third, 0.0) + overlap
                del near[third][other]
                near[third][one] = mine[third]
        near[other] = {}
        others = np.fromiter(mine, np.int64, len(mine))
        shared = np.fromiter(mine.values(), np.float64, len(mine))
        unions = reach[others] @ seen_in[one] + seen_in[others] @ reach[one] - shared
        ious = shared / np.maximum(unions, 1)
        for place in np.flatnonzero(ious > least_iou).tolist():
            low, high = sorted((one, int(others[place])))
            heapq.heappush(heap, (-float(ious[place]), low, high, grown[low], grown[high]))
    for region in range(count):  # a parent comes before what was merged into it
        parent[region] = parent[parent[region]]
    return np.unique(parent, return_inverse=True)[1].astype(np.int64)


def mean_embeddings(
    embeddings: Tensor, member: NDArray[np.int64], mass: NDArray[np.floating], count: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Mean embedding of the regions of each thing, and how much they agree.

    Regions count by the square roots of their masses; zero embeddings count nothing.

    Args:
        embeddings: [R, D] of all regions of a level.
        member: [R] thing of each region, -1 for none.
        mass: [R] of each region.
        count: T.

    Returns:
        [T, D] float32 unit (zero where nothing is known), and [T] float32 norm of the mean of unit embeddings, 0..1.
    """
    # Rounded as they are kept beside region sums, from which later updates take them.
    rows = normalise_embeddings(embeddings.cpu().half().float()).double().numpy()
    mine = np.flatnonzero((member >= 0) & rows.any(1))
    weights = np.sqrt(mass[mine].astype(np.float64))
    summed = np.zeros((count, rows.shape[1]))
    np.add.at(summed, member[mine], weights[:, None] * rows[mine])
    total = np.bincount(member[mine], weights, count)
    norm = np.linalg.norm(summed, axis=1)
    agreement = np.divide(norm, total, out=np.ones(count), where=total > 0).clip(0, 1)
    unit = summed / np.maximum(norm, 1e-300)[:, None]
    return unit.astype(np.float32), agreement.astype(np.float32)


def _owners(matrix: Matrix, member: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """[N] the thing that each Gaussian contributes most to; the largest of equals, -1 for none."""
    from scipy.sparse import csr_array

    owners = np.full(matrix.shape[0], -1)
    mine = np.flatnonzero(member >= 0)
    if not count or not len(mine):
        return owners
    one_hot = csr_array((np.ones(len(mine)), (mine, member[mine])), (matrix.shape[1], count))
    votes: Matrix = (matrix.astype(np.float64) @ one_hot).tocsr()
    votes.sort_indices()
    lengths = np.diff(votes.indptr)
    there = np.flatnonzero(lengths)
    starts = votes.indptr[there]
    most = np.maximum.reduceat(votes.data, starts)
    is_most = votes.data == np.repeat(most, lengths[there])
    # The first of the largest of each row: minimum over places that are not the largest is never taken.
    places = np.where(is_most, np.arange(len(votes.data)), len(votes.data))
    owners[there] = votes.indices[np.minimum.reduceat(places, starts)]
    return owners


def _joined(found: Sequence[_LevelThings], sums: RegionSums, total: NDArray[np.float64]) -> Things:
    """The things of all levels, numbered level by level, with their parents; Gaussians in the order of the scene."""
    sizes = [len(level.agreement) for level in found]
    first = np.cumsum([0, *sizes])
    owners = np.full((sums.n_gaussians, len(found)), NO_THING, np.int64)
    parents = np.full(first[-1], NO_THING, np.int64)
    mass = np.zeros(first[-1])
    for number, level in enumerate(found):
        there = level.owners >= 0
        owners[there, number] = level.owners[there] + first[number]
        mass[first[number] : first[number + 1]] = np.bincount(
            level.owners[there], total[there], sizes[number]
        )
    for number in range(len(found) - 1):
        both = (owners[:, number] != NO_THING) & (owners[:, number + 1] != NO_THING)
        keys = (
            (owners[both, number] - first[number]) * sizes[number + 1]
            + owners[both, number + 1]
            - first[number + 1]
        )
        shared = np.bincount(keys, total[both], sizes[number] * sizes[number + 1]).reshape(sizes[number], -1)
        if shared.size:
            best = shared.argmax(1)
            mine = slice(first[number], first[number + 1])
            held = shared.max(1) > INSIDE * np.maximum(mass[mine], 1e-12)
            parents[mine] = np.where(held, best + first[number + 1], NO_THING)
    in_scene = np.empty_like(owners)
    in_scene[sums.order.numpy()] = owners
    return Things(
        torch.from_numpy(in_scene.astype(np.int32)),
        torch.from_numpy(np.repeat(np.arange(len(found)), sizes).astype(np.uint8)),
        torch.from_numpy(parents.astype(np.int32)),
        torch.from_numpy(np.concatenate([level.embeddings for level in found])).half(),
        torch.from_numpy(np.concatenate([level.agreement for level in found])),
        torch.from_numpy(np.concatenate([level.n_regions for level in found])),
        torch.from_numpy(mass.astype(np.float32)),
    )
