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
Near = tuple[NDArray[Any], NDArray[Any]]
"""Regions that overlap with one, and the overlaps."""

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
    by_region = root.T.tocsr()
    reach = (by_region @ seen).toarray()  # D
    overlap = (by_region @ root).tocoo()  # by rows
    others = views[overlap.row] != views[overlap.col]
    first, second, overlaps = overlap.row[others], overlap.col[others], overlap.data[others]
    edges = np.cumsum(np.bincount(first, minlength=count))[:-1]
    near = list(zip(np.split(second, edges), np.split(overlaps, edges), strict=True))
    above = first < second
    first, second, overlaps = first[above], second[above], overlaps[above]
    union = reach[first, views[second]] + reach[second, views[first]] - overlaps
    labels = _agglomerate(
        first, second, overlaps / np.maximum(union, 1), near, reach.copy(), views, least_iou
    )
    same = labels[first] == labels[second]
    shared = 2.0 * np.bincount(labels[first[same]], overlaps[same], labels.max() + 1)
    return labels, _stability(labels, shared, reach, views)


def _agglomerate(
    first: NDArray[np.int32],  # [P]
    second: NDArray[np.int32],  # [P]
    ious: NDArray[np.float64],  # [P]
    near: list[Near],  # [R], changed
    reach: NDArray[np.float64],  # [R, V], changed
    views: NDArray[np.int64],  # [R]
    least_iou: float,
) -> NDArray[np.int64]:
    """Merge best pair first, by a heap; an entry is stale once one of the two has grown."""
    count = len(views)
    seen_in = np.zeros_like(reach)
    seen_in[np.arange(count), views] = 1
    grown, cluster, members = [0] * count, np.arange(count), [[region] for region in range(count)]
    above = ious > least_iou
    begun = (values[above].tolist() for values in (-ious, first, second))
    heap = [(iou, a, b, 0, 0) for iou, a, b in zip(*begun, strict=True)]
    heapq.heapify(heap)
    while heap:
        _, one, other, *ages = heapq.heappop(heap)
        if ages != [grown[one], grown[other]]:
            continue
        cluster[members[other]] = one
        members[one] += members[other]
        grown[one] += 1
        grown[other] = -1  # no entry has that age
        reach[one] += reach[other]
        seen_in[one] += seen_in[other]
        regions, parts = (np.concatenate(both) for both in zip(near[one], near[other], strict=True))
        total = np.bincount(cluster[regions], parts, count)
        total[one] = 0
        others = np.flatnonzero(total > 0)
        shared = total[others]
        near[one] = others, shared
        in_views = np.flatnonzero(seen_in[one])
        forth = reach[others[:, None], in_views] @ seen_in[one, in_views]
        # The union is at least this large: no cluster overlaps further than it is seen.
        likely = shared / np.maximum(forth, 1) > least_iou
        others, forth, shared = others[likely], forth[likely], shared[likely]
        ious = shared / np.maximum(forth + seen_in[others] @ reach[one] - shared, 1)
        for iou, third in zip(ious.tolist(), others.tolist(), strict=True):
            if iou > least_iou:
                low, high = (one, third) if one < third else (third, one)
                heapq.heappush(heap, (-iou, low, high, grown[low], grown[high]))
    return np.unique(cluster, return_inverse=True)[1].astype(np.int64)


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
