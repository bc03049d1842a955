"""Region sums as sparse matrices, for dense uplift and studies; the vote reads the entries themselves."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from scoup.uplift.storage.entries import ViewRecord

if TYPE_CHECKING:
    from scipy.sparse import csr_array


def triplets_of(
    view: ViewRecord, order: NDArray[np.int64], level: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float32]]:
    """See ``RegionSums.triplets``; ``order`` [N] is the row in the scene of each Gaussian."""
    gaussians, regions, weights = [], [], []
    for part in view.parts:
        part.check_numbers(len(order))
        region = part.table[:, level][part.combinations].astype(np.int64)
        there = region >= 0
        gaussians.append(order[part.gaussians()[there]])
        regions.append(region[there])
        with np.errstate(all="ignore"):  # a damaged weight may be NaN
            weights.append(part.weights[there].astype(np.float64))
    gaussian, region, weight = map(np.concatenate, (gaussians, regions, weights))
    stride = int(region.max(initial=0)) + 1
    keys, inverse = np.unique(gaussian * stride + region, return_inverse=True)
    with np.errstate(all="ignore"):  # or too large
        total = np.bincount(inverse, weight, len(keys)).astype(np.float32)
    return keys // stride, keys % stride, total


def csr_matrix(
    views: Mapping[str, ViewRecord], order: NDArray[np.int64], level: int, rows: Mapping[str, slice]
) -> csr_array:
    """See ``RegionSums.matrix``. Entries are placed view by view: 8 bytes per non-zero in all."""
    from scipy.sparse import csr_array

    count, total = len(order), max((part.stop for part in rows.values()), default=0)
    ends = np.zeros(count + 1, np.int64)
    for view in views.values():
        ends[1:] += np.bincount(triplets_of(view, order, level)[0], minlength=count)
    np.cumsum(ends, out=ends)
    columns = np.empty(ends[-1], np.int32)
    weights = np.empty(ends[-1], np.float32)
    free = ends[:-1].copy()  # the next place of each Gaussian
    for name, view in views.items():
        gaussian, region, weight = triplets_of(view, order, level)
        # The regions of the view to which one Gaussian contributes follow each other.
        first = np.flatnonzero(np.diff(gaussian, prepend=-1))
        repeats = np.diff(first, append=len(gaussian))
        at = free[gaussian] + np.arange(len(gaussian)) - np.repeat(first, repeats)
        columns[at] = region + rows[name].start
        weights[at] = weight
        free[gaussian[first]] += repeats
    return csr_array((weights, columns, ends), shape=(count, total))
