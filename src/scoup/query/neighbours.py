"""Smoothing of per-Gaussian values over nearest neighbours in space."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

_CHUNK = 65536


@dataclass(frozen=True, eq=False)
class Neighbourhood:
    """The nearest neighbours of some of N points.

    Attributes:
        members: [M] int64, the points that have neighbours and may be one.
        nearest: [M, B] int64, the B nearest other members of each, nearest first; B may be 0.
    """

    members: Tensor  # [M]
    nearest: Tensor  # [M, B]

    @classmethod
    def of(cls, points: Tensor, included: Tensor, count: int) -> Neighbourhood:
        """The ``count`` nearest neighbours (fewer if there are not so many) among the points included.

        Args:
            points: [N, 3] positions; those that are not finite are left out.
            included: boolean [N].
            count: neighbours wanted, the point itself not counted.
        """
        from scipy.spatial import KDTree

        members = (included.cpu() & torch.isfinite(points).all(1).cpu()).nonzero()[:, 0]
        places = points.cpu()[members].double().numpy()
        wanted = min(count, max(len(members) - 1, 0))
        if wanted == 0:
            return cls(members, members.new_zeros(len(members), 0))
        tree = KDTree(places)
        blocks = []
        for start in range(0, len(places), _CHUNK):
            rows = slice(start, start + _CHUNK)
            found = np.asarray(tree.query(places[rows], k=wanted + 1, workers=-1)[1])
            blocks.append(_without_self(found, np.arange(start, start + len(found))))
        return cls(members, members[torch.from_numpy(np.concatenate(blocks))])

    def blend(self, values: Tensor, included: Tensor) -> Tensor:
        """Half of each member's value and half of the mean over its neighbours; others keep theirs.

        Args:
            values: [S, N].
            included: boolean [S, N]; neighbours not included do not count, and where none is, values stay.

        Returns:
            [S, N] as ``values``.
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


def _without_self(found: np.ndarray, own: np.ndarray) -> np.ndarray:
    """[M, B] neighbours without the point itself, which may be anywhere among points at its place.

    If more points share the place than were searched for, it may be missing; then the last neighbour is left out.
    """
    itself = found == own[:, None]
    itself[:, -1] |= ~itself.any(1)
    return found[~itself].reshape(len(found), -1)
