"""Things without training: regions of many views that the same Gaussians contribute to are one instance.

Two regions r of view a and q of view b overlap by I = sum over Gaussians of sqrt(A_ir A_iq). Each can overlap only as
far as the other view sees it: D_rb = sum of sqrt(A_ir V_ib), where V_ib is what Gaussian i contributes to all regions
of view b. So IoU = I / (D_rb + D_qa - I). Regions of one level merge best pair first, down to ``LEAST_IOU``. Clusters
are compared by the same ratio of sums over all their pairs of regions (average linkage, weighed by mass; two regions of
one view do not overlap). Own; measured in docs/answers.md.

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

from scoup.base.counts import spread
from scoup.base.progress import Progress, no_progress
from scoup.scene.codes import SparseCodes, index_dtype
from scoup.scene.directions import normalise_embeddings
from scoup.scene.things import MOST_THINGS, NO_THING, ThingTable
from scoup.uplift.region_sums import RegionSums
from scoup.uplift.storage.entries import Entries
from scoup.uplift.vote import vote

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
MOST_VIEWS = 48
"""Of more views so many, evenly spread by their names, make the things; merging takes time with their square."""
MOST_DECIDING = 300_000
"""Of more Gaussians only every second, third, ... decides what is merged; all of them have owners."""
LEAST_REGIONS = 2
"""A region that no other view confirms is no thing."""
ROOT_STEPS = 64.0
"""Whole numbers that stand for a square root of 1 pixel."""
INSIDE = 0.5
"""Share of a thing's Gaussians that its parent must own, too."""


def find_things(
    sums: RegionSums,
    embeddings: Sequence[Tensor],
    progress: Progress = no_progress,
) -> ThingTable:
    """Merge the regions of all views into things.

    Args:
        sums: of the views, with the rows of their regions among the embeddings (``RegionSums.of_views``).
        embeddings: per level [R, D], of the regions of all views. They do not decide what is merged.
        progress: called for the stage "things".
    """
    assert sums.rows is not None
    names = spread(sorted(sums.rows[0]), MOST_VIEWS)
    entries = _of_large_gaussians(_strong_entries(sums, names))
    found: list[_LevelThings] = []
    for number, (rows, of_level) in enumerate(zip(sums.rows, embeddings, strict=True)):
        progress("things", number, len(embeddings))
        matrix = _by_region(entries, number, len(of_level))
        mine = {name: rows[name] for name in names}
        found.append(_things_of_level(matrix, mine, of_level, MOST_THINGS // len(embeddings)))
    progress("things", len(embeddings), len(embeddings))
    return _joined(found, _owners(sums, found))


@dataclass(frozen=True, eq=False)
class _StrongEntries:
    """What the Gaussians that decide contribute to regions, without what is weak.

    Attributes:
        gaussians: [E] int32 in the order of the sums.
        regions: [E, S] int32, rows of the regions among those of all views; -1 for none.
        weights: [E] float32.
        total: [N] float64, of each of these Gaussians over all views; 0 for the others.
    """

    gaussians: NDArray[np.int32]
    regions: NDArray[np.int32]
    weights: NDArray[np.float32]
    total: NDArray[np.float64]


def _strong_entries(sums: RegionSums, names: Sequence[str]) -> _StrongEntries:
    """Of every so manieth Gaussian, in the order of the sums, which is that of space."""
    count = sums.n_gaussians
    assert sums.rows is not None
    stride = -(-count // MOST_DECIDING)
    total, largest = np.zeros(count), np.zeros(count, np.float32)
    for name in names:
        for part in sums.views[name].parts:
            part.check_numbers(count)
            gaussians, weights, _ = _deciding(part, stride)
            starts = np.flatnonzero(np.diff(gaussians, prepend=-1))
            if len(starts):
                each = gaussians[starts]
                total[each] += np.add.reduceat(weights.astype(np.float64), starts)
                largest[each] = np.maximum(largest[each], np.maximum.reduceat(weights, starts))
    kept = [(np.zeros(0, np.int32), np.zeros((0, len(sums.rows)), np.int32), np.zeros(0, np.float32))]
    for name in names:
        firsts = np.array([rows[name].start for rows in sums.rows])
        for part in sums.views[name].parts:
            gaussians, weights, combinations = _deciding(part, stride)
            strong = np.flatnonzero((weights >= LEAST_SHARE * largest[gaussians]) & (weights > 0))
            table = np.where(part.table >= 0, part.table + firsts, -1).astype(np.int32)
            kept.append((gaussians[strong].astype(np.int32), table[combinations[strong]], weights[strong]))
    gaussians, regions, weights = (np.concatenate(parts) for parts in zip(*kept, strict=True))
    return _StrongEntries(gaussians, regions, weights, total)


def _deciding(
    part: Entries, stride: int
) -> tuple[NDArray[np.int64], NDArray[np.float32], NDArray[np.uint16]]:
    """(gaussian, weight, combination) of the entries whose Gaussians decide."""
    gaussians = part.gaussians()
    if stride == 1:
        return gaussians, part.weights.astype(np.float32), part.combinations
    chosen = np.flatnonzero(gaussians % stride == 0)
    return gaussians[chosen], part.weights[chosen].astype(np.float32), part.combinations[chosen]


def _of_large_gaussians(entries: _StrongEntries) -> _StrongEntries:
    """Return the entries without those of Gaussians that contribute little."""
    order = np.argsort(-entries.total, kind="stable")
    mass = np.cumsum(entries.total[order])
    decides = np.zeros(len(entries.total), bool)
    if len(mass) and mass[-1] > 0:
        decides[order[: int(np.searchsorted(mass, MASS * mass[-1])) + 1]] = True
    mine = decides[entries.gaussians]
    return _StrongEntries(
        entries.gaussians[mine], entries.regions[mine], entries.weights[mine], entries.total
    )


def _by_region(entries: _StrongEntries, level: int, n_regions: int) -> Matrix:
    """[N, R] float32 of one level."""
    from scipy.sparse import coo_array

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
        member: [R] int64 thing of each region, -1 for none.
        embeddings: [T, D] float32.
        agreement, mass, stability: [T] float32.
        n_regions: [T] int32.
    """

    member: NDArray[np.int64]
    embeddings: NDArray[np.float32]
    agreement: NDArray[np.float32]
    n_regions: NDArray[np.int32]
    mass: NDArray[np.float32]
    stability: NDArray[np.float32]


def _things_of_level(
    matrix: Matrix, rows: Mapping[str, slice], embeddings: Tensor, most: int
) -> _LevelThings:
    order, views = np.zeros(0, np.int64), np.zeros(0, np.int64)
    for number, name in enumerate(sorted(rows)):
        mine = np.arange(rows[name].start, rows[name].stop)
        order, views = np.append(order, mine), np.append(views, np.full(len(mine), number))
    labels = np.full(matrix.shape[1], -1)
    labels[order], stability = merge_regions(matrix[:, order], views)
    region_mass = np.asarray(matrix.sum(0)).ravel()
    sizes = np.bincount(labels[order], minlength=1)
    mass = np.bincount(labels[order], region_mass[order], len(sizes))
    things = np.flatnonzero((sizes >= LEAST_REGIONS) & (mass > 0))
    things = things[np.argsort(-mass[things], kind="stable")][:most]
    place = np.full(len(sizes), -1)
    place[things] = np.arange(len(things))
    member = np.where(labels >= 0, place[labels], -1)
    means, agreement = mean_embeddings(embeddings, member, region_mass, len(things))
    counts = sizes[things].astype(np.int32)
    masses, stable = mass[things].astype(np.float32), stability[things].astype(np.float32)
    return _LevelThings(member, means, agreement, counts, masses, stable)


def merge_regions(
    matrix: Matrix, views: NDArray[np.int64], least_iou: float = LEAST_IOU
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Cluster the regions of one level.

    Args:
        matrix: [N, R] float32, what each Gaussian contributes to each region of one level.
        views: [R] the view of each region, from 0.
        least_iou: clusters that overlap less stay apart.

    Returns:
        [R] int64 the cluster of each region, from 0, in the order of their first regions; and [C] float64 the
        stability of each cluster (``scoup.scene.things.ThingTable``), 0..1.
    """
    from scipy.sparse import csr_array

    count = len(views)
    if not count:
        return np.zeros(0, np.int64), np.zeros(0)
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
    labels = _agglomerate(pairs, overlaps[keep], union[keep], reach.copy(), views, least_iou)
    same = labels[first] == labels[second]
    shared = 2.0 * np.bincount(labels[first[same]], overlaps[same], labels.max() + 1)
    return labels, _stability(labels, shared, reach, views)


def _agglomerate(
    pairs: NDArray[np.int64],  # [P, 2]
    overlaps: NDArray[np.float64],  # [P]
    unions: NDArray[np.float64],  # [P]
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


def _stability(
    labels: NDArray[np.int64],  # [R]
    shared: NDArray[
        np.floating
    ],  # [C] overlap of a cluster's regions with those in other views, each pair twice
    reach: NDArray[np.float64],  # [R, V]
    views: NDArray[np.int64],  # [R]
) -> NDArray[np.float64]:
    """The ratio by which clusters are compared, of each cluster with itself in all other views."""
    clusters = len(shared)
    regions, of_cluster = np.zeros((clusters, reach.shape[1])), np.zeros((clusters, reach.shape[1]))
    np.add.at(regions, (labels, views), 1)
    np.add.at(of_cluster, labels, reach)
    own = reach[np.arange(len(views)), views]
    seen = of_cluster.sum(1) - np.bincount(labels, own, clusters)
    back = (regions * of_cluster).sum(1) - np.bincount(labels, own * regions[labels, views], clusters)
    return shared / np.maximum(seen + back - shared, 1)


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


def _owners(sums: RegionSums, found: Sequence[_LevelThings]) -> NDArray[np.int64]:
    """[N, S] the thing of its level that each Gaussian of the scene contributes to most, -1 for none.

    That is a vote in which the code of a region is its thing.
    """
    most = max(1, *(len(level.agreement) for level in found))
    codes = []
    for level in found:
        there = torch.from_numpy(level.member >= 0)
        indices = torch.from_numpy(level.member).clamp(min=0)[:, None].to(index_dtype(most))
        codes.append(SparseCodes(indices, there[:, None].float(), most))
    voted = vote(sums, codes, torch.ones(len(found), most, 1), keep=1)
    owners = voted.indices[..., 0].numpy().astype(np.int64)
    return np.where(voted.weights[..., 0].numpy() > 0, owners, -1)


def _joined(found: Sequence[_LevelThings], owners: NDArray[np.int64]) -> ThingTable:
    """The things of all levels, numbered level by level, with their parents."""
    sizes = [len(level.agreement) for level in found]
    first = np.cumsum([0, *sizes])
    parents = np.full(first[-1], NO_THING, np.int32)
    for number in range(len(found) - 1):
        fine, coarse = owners[:, number], owners[:, number + 1]
        own = np.bincount(fine[fine >= 0], minlength=sizes[number])
        both = (fine >= 0) & (coarse >= 0)
        keys, counts = np.unique(fine[both] * max(1, sizes[number + 1]) + coarse[both], return_counts=True)
        thing, parent = np.divmod(keys, max(1, sizes[number + 1]))
        inside = counts > INSIDE * own[thing]  # true of one parent at most
        parents[first[number] + thing[inside]] = first[number + 1] + parent[inside]
    numbered = np.where(owners >= 0, owners + first[:-1], NO_THING)
    return ThingTable(
        torch.from_numpy(numbered.astype(np.int32)),
        torch.from_numpy(np.repeat(np.arange(len(found)), sizes).astype(np.uint8)),
        torch.from_numpy(parents),
        torch.from_numpy(np.concatenate([level.embeddings for level in found])).half(),
        torch.from_numpy(np.concatenate([level.agreement for level in found])),
        torch.from_numpy(np.concatenate([level.n_regions for level in found])),
        torch.from_numpy(np.concatenate([level.mass for level in found])),
        torch.from_numpy(np.concatenate([level.stability for level in found])),
    )
