"""Values of Gaussians smoothed over nearest neighbours in space."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

_CHUNK = 65536


@dataclass(frozen=True, eq=False)
class Neighbourhood:
    """The nearest neighbours of some of N points."""

    members: Tensor  # [M] int64, the points that have neighbours and may be one
    nearest: Tensor  # [M, B] int64, the B nearest other members of each, nearest first; B may be 0

    @classmethod
    def of(cls, points: Tensor, included: Tensor, count: int) -> Neighbourhood:
        """Find ``count`` nearest neighbours, without the point itself, of points [N, 3] included [N] and finite."""
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


def _without_self(found: np.ndarray, own: np.ndarray) -> np.ndarray:
    """Neighbours [M, B] without the point itself.

    It may be anywhere among points at its place, or missing if these are more than were searched for; then the last
    neighbour is left out.
    """
    itself = found == own[:, None]
    itself[:, -1] |= ~itself.any(1)
    return found[~itself].reshape(len(found), -1)
