"""Selections of Gaussians grown, shrunk or reduced to their largest part."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from scoup.base.errors import InputError
from scoup.query.space import LONGEST_LINK, NEIGHBOURS, connected_parts
from scoup.scene.gaussians import Gaussians
from scoup.scene.neighbours import nearest_points

MOST_STEPS = 1000


@dataclass(frozen=True)
class Reshaping:
    """Changes to a selection, applied in this order.

    Raises:
        InputError: a number is negative, not finite or beyond ``MOST_STEPS``.

    Example:
        >>> field = scoup.LanguageField.load("f.scoup")
        >>> question = field.question("kettle", always=True)
        >>> whole, largest = field.select(question), field.select(question, scoup.Reshaping(largest=True))
        >>> bool(largest.mask.sum() <= whole.mask.sum())
        True
    """

    largest: bool = False
    """Keep only the connected part that weighs most, as the first of ``field.things`` in a field without things."""
    shrink: int = 0
    """Remove the Gaussians that have a neighbour outside, so many times."""
    grow: int = 0
    """Add the neighbours of those inside, so many times."""
    within: float = 0.0
    """Add every Gaussian whose centre is at most this far from the centre of one inside, in world units."""

    def __post_init__(self) -> None:
        for name in ("shrink", "grow"):
            if not 0 <= getattr(self, name) <= MOST_STEPS:
                raise InputError(f"{name} must be 0 to {MOST_STEPS}, got {getattr(self, name)}")
        if not (self.within >= 0 and math.isfinite(self.within)):
            raise InputError(f"within must be a distance of 0 or more, got {self.within}")

    @property
    def changes(self) -> bool:
        """Return whether it changes anything."""
        return self != UNCHANGED


UNCHANGED = Reshaping()


def reshaped(gaussians: Gaussians, mask: Tensor, relevancy: Tensor, wanted: Reshaping) -> Tensor:
    """Reshape a selection, [N] boolean.

    Neighbours of a Gaussian are the ``NEIGHBOURS`` nearest that are not much further away than usual among those
    inside. Gaussians that are not finite have none, and are not added.

    Args:
        gaussians: N of them, on any device.
        mask: [N] boolean, the selection.
        relevancy: [N]; parts weigh relevancy times opacity.
        wanted: the changes.
    """
    means = gaussians.means.cpu().double()
    usable = torch.isfinite(means).all(1)
    inside = (mask.cpu() & usable)[usable].numpy()
    points = means[usable].numpy()
    if wanted.largest and inside.any():
        weights = (gaussians.opacities.cpu().double().clamp(0, 1) * relevancy.cpu().double())[usable].numpy()
        parts = connected_parts(points[inside])
        kept = parts == np.bincount(parts, np.nan_to_num(weights[inside])).argmax()
        inside[inside] = kept
    if (wanted.shrink or wanted.grow) and inside.any() and len(points) > 1:
        near = _Neighbours(points, inside)
        for _ in range(wanted.shrink):
            inside &= ~near.any_of(~inside)
        for _ in range(wanted.grow):
            inside |= near.any_of(inside)
    if wanted.within and inside.any():
        inside |= near_points(points, inside, wanted.within)
    out = torch.zeros(len(mask), dtype=torch.bool)
    out[usable] = torch.from_numpy(inside)
    return out


def near_points(points: NDArray[np.float64], inside: NDArray[np.bool_], distance: float) -> NDArray[np.bool_]:
    """Return which points [N, 3] are at most this far from one of those inside, [N] boolean."""
    from scipy.spatial import KDTree

    nearest = KDTree(points[inside]).query(points, workers=-1)[0]
    return np.asarray(nearest) <= distance


class _Neighbours:
    """Links from points to their nearest others, as long as usual among those inside."""

    def __init__(self, points: NDArray[np.float64], inside: NDArray[np.bool_]) -> None:
        nearest, lengths = nearest_points(points, min(NEIGHBOURS, len(points) - 1))
        self._nearest = nearest
        self._linked = lengths <= LONGEST_LINK * np.median(lengths[inside][:, -1])

    def any_of(self, members: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return which points are linked to any of these, themselves included, [N] boolean."""
        return members | (members[self._nearest] & self._linked).any(1)
