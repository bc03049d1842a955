"""Values smoothed over nearest neighbours in space."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from scoup.scene.neighbours import nearest_points


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
