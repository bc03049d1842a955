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
    for entries in view.parts:
        entries.check_numbers(len(order))
        region = entries.table[:, level][entries.combinations].astype(np.int64)
        there = region >= 0
        gaussians.append(order[entries.gaussians()[there]])
        regions.append(region[there])
        with np.errstate(all="ignore"):  # a damaged weight may be NaN
            weights.append(entries.weights[there].astype(np.float64))
    gaussian, region, weight = map(np.concatenate, (gaussians, regions, weights))
    stride = int(region.max(initial=0)) + 1
    keys, inverse = np.unique(gaussian * stride + region, return_inverse=True)
    with np.errstate(all="ignore"):  # or too large
        total = np.bincount(inverse, weight, len(keys)).astype(np.float32)
    return keys // stride, keys % stride, total


def csr_matrix(
    views: Mapping[str, ViewRecord], order: NDArray[np.int64], level: int, rows: Mapping[str, slice]
) -> csr_array:
    """See ``RegionSums.matrix``."""
    from scipy.sparse import coo_array

    parts = [(np.zeros(0, np.int32), np.zeros(0, np.int32), np.zeros(0, np.float32))]
    for name, view in views.items():
        gaussian, region, weight = triplets_of(view, order, level)
        parts.append((gaussian.astype(np.int32), (region + rows[name].start).astype(np.int32), weight))
    gaussians, regions, weights = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    shape = len(order), max((span.stop for span in rows.values()), default=0)
    return coo_array((weights, (gaussians, regions)), shape).tocsr()
