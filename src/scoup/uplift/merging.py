"""Merging of the regions of one level, best pair first: the clusters are things.

Two regions r of view a and q of view b overlap by I = sum over Gaussians of sqrt(A_ir A_iq). Each can overlap only as
far as the other view sees it: D_rb = sum of sqrt(A_ir V_ib), where V_ib is what Gaussian i contributes to all regions
of view b. So IoU = I / (D_rb + D_qa - I). Regions merge best pair first, down to ``LEAST_IOU``. Clusters are compared
by the same ratio of sums over all their pairs of regions (average linkage, weighted by mass; two regions of one view do
not overlap). Own; measured in docs/answers.md.

Square roots are rounded to whole numbers, so every sum is exact, in any order.
"""

from __future__ import annotations

import heapq
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scoup.uplift import constants

Matrix = Any
"""A scipy CSR array, which type checkers know little of."""

ROOT_STEPS = 64.0  # whole numbers that stand for a square root of 1 pixel


def merge_regions(
    matrix: Matrix, views: NDArray[np.int64], least_iou: float | None = None
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Cluster the regions of one level by ``matrix`` [N, R] float32, what each Gaussian contributes to each region, and
    ``views`` [R] from 0; clusters that overlap less than ``least_iou``, by
    default ``LEAST_IOU``, stay apart.

    Returns:
        [R] int64 the cluster of each region, from 0, in the order of first regions; and [C] float64 the stability of
        each cluster (``scoup.field.thing_table.ThingTable``), 0..1.
    """
    from scipy.sparse import csr_array

    least_iou = constants.LEAST_IOU if least_iou is None else least_iou
    count = len(views)
    if not count:
        return np.zeros(0, np.int64), np.zeros(0)
    n_views = int(views.max()) + 1
    one_hot = csr_array((np.ones(count), (np.arange(count), views)), (count, n_views))
    # Whole numbers below 2^53 in float64: exact sums.
    root: Matrix = matrix.astype(np.float64)
    seen: Matrix = (root @ one_hot).tocsr()
    root.data, seen.data = (np.rint(ROOT_STEPS * np.sqrt(item.data)) for item in (root, seen))
    overlap = (root.T.tocsr() @ root).tocoo()
    reach = (root.T @ seen).toarray()  # D
    first, second = overlap.row, overlap.col
    above = (first < second) & (views[first] != views[second])
    first, second, overlaps = first[above], second[above], overlap.data[above]
    union = reach[first, views[second]] + reach[second, views[first]] - overlaps
    pairs = np.stack([first, second], 1)
    labels = _agglomerate(pairs, overlaps, union, reach.copy(), views, least_iou)
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
    """Merge best pair first, by a heap; an entry is stale once one of the two has grown."""
    count = len(views)
    near = _neighbours(pairs, overlaps, count)
    seen_in = np.zeros_like(reach)
    seen_in[np.arange(count), views] = 1
    grown, cluster = [0] * count, np.arange(count)
    ious = overlaps / np.maximum(unions, 1)
    above = ious > least_iou
    heap = [
        (-iou, a, b, 0, 0) for iou, (a, b) in zip(ious[above].tolist(), pairs[above].tolist(), strict=True)
    ]
    heapq.heapify(heap)
    while heap:
        _, one, other, *ages = heapq.heappop(heap)
        if ages != [grown[one], grown[other]]:
            continue
        cluster[cluster == other] = one
        grown[one] += 1
        grown[other] = -1  # no entry has that age
        reach[one] += reach[other]
        seen_in[one] += seen_in[other]
        regions, parts = (np.concatenate(both) for both in zip(near[one], near[other], strict=True))
        total = np.bincount(cluster[regions], parts, count)
        total[one] = 0
        others = np.flatnonzero(total)
        shared = total[others].astype(np.float64)
        near[one] = others, shared
        unions = reach[others] @ seen_in[one] + seen_in[others] @ reach[one] - shared
        ious = shared / np.maximum(unions, 1)
        for index in np.flatnonzero(ious > least_iou).tolist():
            low, high = sorted((one, int(others[index])))
            heapq.heappush(heap, (-float(ious[index]), low, high, grown[low], grown[high]))
    return np.unique(cluster, return_inverse=True)[1].astype(np.int64)


def _neighbours(
    pairs: NDArray[np.int64],  # [P, 2]
    overlaps: NDArray[np.float64],  # [P]
    count: int,
) -> list[tuple[NDArray[np.int64], NDArray[np.float64]]]:
    """Return the overlapping regions of each region, and the overlaps."""
    order = np.argsort(pairs.T.ravel(), kind="stable")
    others, overlaps = pairs[:, ::-1].T.ravel()[order], np.tile(overlaps, 2)[order]
    edges = np.cumsum(np.bincount(pairs.ravel(), minlength=count))[:-1]
    return list(zip(np.split(others, edges), np.split(overlaps, edges), strict=True))


def _stability(
    labels: NDArray[np.int64],  # [R]
    shared: NDArray[np.floating],  # [C] overlap of a cluster's regions between views, each pair twice
    reach: NDArray[np.float64],  # [R, V]
    views: NDArray[np.int64],  # [R]
) -> NDArray[np.float64]:
    """Return [C], the ratio by which clusters are compared, of each cluster with itself in all other views."""
    clusters = len(shared)
    regions, of_cluster = np.zeros((clusters, reach.shape[1])), np.zeros((clusters, reach.shape[1]))
    np.add.at(regions, (labels, views), 1)
    np.add.at(of_cluster, labels, reach)
    inner = reach[np.arange(len(views)), views]
    seen = of_cluster.sum(1) - np.bincount(labels, inner, clusters)
    back = (regions * of_cluster).sum(1) - np.bincount(labels, inner * regions[labels, views], clusters)
    return shared / np.maximum(seen + back - shared, 1)
