"""Nearest neighbours in space: values smoothed over them, and the parts that they connect.

The compiled core finds them, or scipy (``plain_...``) where there is none.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from scoup.base.native import native_core

_CHUNK = 65536


@dataclass(frozen=True, eq=False)
class Neighbourhood:
    """The nearest neighbours of some of N points."""

    members: Tensor  # [M] int64, the points that have neighbours and may be one
    nearest: Tensor  # [M, B] int64, the B nearest other members of each, nearest first; B may be 0

    @classmethod
    def of(cls, points: Tensor, included: Tensor, count: int) -> Neighbourhood:
        """Find ``count`` nearest neighbours, without the point itself, of points [N, 3] included [N] and finite."""
        members = (included.cpu() & torch.isfinite(points).all(1).cpu()).nonzero()[:, 0]
        wanted = min(count, max(len(members) - 1, 0))
        nearest = nearest_points(points.cpu()[members].double().numpy(), wanted)[0]
        return cls(members, members[torch.from_numpy(nearest)])

    def blend(self, values: Tensor, included: Tensor) -> Tensor:
        """Return half of each member's value [S, N] and half of the mean over its neighbours included [S, N]; without
        any, values stay.
        """
        out = values.clone()
        for level in range(len(values)):
            counted = included[level].to(values.dtype)
            nearest = self.nearest.to(values.device)
            number = counted[nearest].sum(1)
            mean = (values[level] * counted)[nearest].sum(1) / number.clamp(min=1)
            own = values[level, self.members]
            out[level, self.members] = torch.where(number > 0, 0.5 * (own + mean), own)
        return out


def nearest_points(points: NDArray[np.float64], count: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the ``count`` nearest others of each point, nearest first, and their distances, both [M, count].

    Of equals, the compiled core takes the one with the lower number.

    Args:
        points: [M, 3], finite.
        count: below M, or 0.
    """
    core = native_core()
    if core is None:
        return plain_nearest_points(points, count)
    return core.nearest_points(np.ascontiguousarray(points), count, torch.get_num_threads())


def plain_nearest_points(
    points: NDArray[np.float64], count: int
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """``nearest_points`` by scipy."""
    from scipy.spatial import KDTree

    if not count:
        return np.zeros((len(points), 0), np.int64), np.zeros((len(points), 0))
    # Cells halved in space, not by points: built in half the time, queried no slower.
    tree = KDTree(points, leafsize=16, balanced_tree=False)
    numbers, lengths = [], []
    for start in range(0, len(points), _CHUNK):
        rows = slice(start, start + _CHUNK)
        far, found = (np.asarray(each) for each in tree.query(points[rows], k=count + 1, workers=-1))
        itself = found == np.arange(start, start + len(found))[:, None]
        # Missing if more points at its place are found than were searched for: then the last one is left out.
        itself[:, -1] |= ~itself.any(1)
        numbers.append(found[~itself].reshape(-1, count))
        lengths.append(far[~itself].reshape(-1, count))
    return np.concatenate(numbers).astype(np.int64), np.concatenate(lengths)


def linked_parts(
    numbers: NDArray[np.int64], lengths: NDArray[np.float64], longest: float
) -> NDArray[np.int64]:
    """Return the number [M] of the part of each point that links [M, B] of at most this length connect.

    Parts are numbered by their first points.
    """
    core = native_core()
    if core is None:
        return plain_linked_parts(numbers, lengths, longest)
    return core.linked_parts(np.ascontiguousarray(numbers), np.ascontiguousarray(lengths), longest)


def plain_linked_parts(
    numbers: NDArray[np.int64], lengths: NDArray[np.float64], longest: float
) -> NDArray[np.int64]:
    """``linked_parts`` by scipy."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components

    near = lengths <= longest
    starts = np.append(0, near.sum(1).cumsum())
    links = csr_array((np.ones(starts[-1]), numbers[near], starts), (len(numbers),) * 2)
    parts = np.asarray(connected_components(links, directed=True, connection="weak")[1])
    first, of_part = np.unique(parts, return_index=True)[1], parts
    return np.argsort(np.argsort(first))[of_part].astype(np.int64)
