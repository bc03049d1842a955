"""Positions, boxes and spans of many things at once, from the Gaussians of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from scoup.base import brief, rounded_vector
from scoup.query import constants
from scoup.scene import Gaussians

BINS = 256
"""Per thing and axis, in which quantiles are looked for."""

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class OrientedBox:
    """An upright box in the world. Tensors are float64 on the CPU."""

    centre: Tensor
    """[3] world units."""
    axes: Tensor
    """[3, 3] one unit direction per row, right-handed: along its longer horizontal side, its shorter one, and up."""
    extent: Tensor
    """[3] length, width and height: full lengths along the axes in world units."""

    __repr__ = brief

    def to_dict(self) -> dict[str, Any]:
        """Return the box as plain JSON values, rounded."""
        axes = [[round(value, 6) for value in row] for row in self.axes.tolist()]
        return {
            "centre": rounded_vector(self.centre.tolist()),
            "axes": axes,
            "extent": rounded_vector(self.extent.tolist()),
        }

    def contains(self, point: Tensor) -> bool:
        """Return whether a point [3] is in the box."""
        return bool(((self.axes @ (point - self.centre)).abs() <= self.extent / 2).all())

    def corners(self) -> Tensor:
        """Return the corners [8, 3]."""
        signs = torch.cartesian_prod(*[torch.tensor([-0.5, 0.5], dtype=torch.float64)] * 3)
        return self.centre + (signs * self.extent) @ self.axes


@dataclass(frozen=True, eq=False)
class PointSets:
    """The Gaussians of T things without strays, one thing after the other. M of them in all."""

    means: Array  # [M, 3]
    weights: Array  # [M] their opacities
    starts: NDArray[np.int64]  # [T + 1], where each thing starts

    @classmethod
    def of(cls, gaussians: Gaussians, members: Sequence[Tensor]) -> PointSets:
        """Make shapes of the Gaussians of each thing, by their numbers; weights are opacities."""
        rows = torch.cat([*members, torch.empty(0, dtype=torch.int64)]).cpu()
        chosen = gaussians.select(rows.to(gaussians.device)).to("cpu")
        means = chosen.means.double().numpy()
        weights = chosen.opacities.double().clamp(0, 1).numpy()
        starts = np.concatenate([[0], np.cumsum([len(numbers) for numbers in members])]).astype(np.int64)
        weights = np.where(np.isfinite(means).all(1) & np.isfinite(weights), weights, 0.0)
        means = np.where(weights[:, None] > 0, means, 0.0)
        every = cls(means, weights, starts)
        distance = np.linalg.norm(means - every.medians()[every.owners], axis=1)
        usual = cls(distance[:, None], weights, starts).quantiles([0.5])[:, 0, 0]
        near = (distance <= constants.FARTHEST * usual[every.owners]) & (weights > 0)
        near_starts = np.concatenate([[0], np.cumsum(near)])[starts]
        return cls(means[near], weights[near], near_starts)

    @classmethod
    def of_one_thing(cls, points: Tensor, weights: Tensor) -> PointSets:
        """Make the shape of one thing from points [M, 3] and their weights [M], some above 0; no point is a stray."""
        return cls(points.numpy(), weights.numpy(), np.array([0, len(points)]))

    def __len__(self) -> int:
        return len(self.starts) - 1

    @cached_property
    def owners(self) -> NDArray[np.int64]:
        """[M] the thing of each Gaussian."""
        return np.repeat(np.arange(len(self)), np.diff(self.starts))

    def of_one(self, number: int) -> Array:
        """Return the means of one thing."""
        return self.means[self.starts[number] : self.starts[number + 1]]

    def medians(self) -> Array:
        """[T, 3] weighted median along each axis; NaN for things without Gaussians."""
        return self.quantiles([0.5])[..., 0]

    def quantiles(self, shares: Sequence[float], axes: Array | None = None) -> Array:
        """[T, A, Q] values below which shares of each thing's weight lie, along axes [T, A, 3] of each."""
        values = self.means
        if axes is not None:
            values = np.einsum("mad,md->ma", axes[self.owners], values)
        ends = np.full((len(self), values.shape[1], len(shares)), np.nan)
        filled = np.flatnonzero(np.diff(self.starts))
        if len(filled):
            firsts, rows = self.starts[filled], np.searchsorted(filled, self.owners)
            for axis in range(values.shape[1]):
                ends[filled, axis] = _quantiles(
                    np.ascontiguousarray(values[:, axis]), self.weights, firsts, rows, shares
                )
        return ends

    def spans(self) -> Array:
        """[T, 3, 2] lower and upper end along each axis; NaN without Gaussians."""
        return self.quantiles([(1 - constants.SPAN) / 2, (1 + constants.SPAN) / 2])

    def boxes(self, up: Tensor) -> list[OrientedBox | None]:
        """Return the box around each thing that is upright by a unit vector [3]; None without Gaussians.

        The horizontal axes are the principal ones, or others between them if the box is clearly smaller along these.
        """
        if not len(self.means):
            return [None] * len(self)
        upright = up.double().cpu().numpy()
        side = np.cross(upright, np.eye(3)[np.abs(upright).argmin()])
        side /= np.linalg.norm(side)
        level = np.stack([side, np.cross(upright, side)])
        turns = self._principal_turns(level)[:, None] + np.arange(constants.TURNS) * (
            np.pi / 2 / constants.TURNS
        )
        some = self.sample(constants.SAMPLED)
        areas = np.stack([some._extents(_upright(turn, level))[:, :2].prod(1) for turn in turns.T], 1)
        best = np.where(areas.min(1) < constants.CLEARLY * areas[:, 0], areas.argmin(1), 0)
        axes = _upright(turns[np.arange(len(self)), best], level)
        extents = self._extents(axes)
        # The longer side first, in the direction whose largest component is positive.
        longer = np.where((extents[:, 0] >= extents[:, 1])[:, None], axes[:, 0], axes[:, 1])
        largest = np.take_along_axis(longer, np.abs(longer).argmax(1)[:, None], 1)
        longer = longer * np.where(largest < 0, -1.0, 1.0)
        axes = np.stack([longer, np.cross(upright, longer), axes[:, 2]], 1)
        ends = self.quantiles([(1 - constants.BOX_WEIGHT) / 2, (1 + constants.BOX_WEIGHT) / 2], axes)
        centres = np.einsum("ta,tad->td", ends.mean(2), axes)
        extents = ends[..., 1] - ends[..., 0]
        return [
            OrientedBox(*map(torch.from_numpy, parts)) if np.isfinite(parts[0]).all() else None
            for parts in zip(centres, axes, extents, strict=True)
        ]

    def _principal_turns(self, level: Array) -> Array:
        """[T] angle of the principal axis in the plane of two directions [2, 3], in radians."""
        flat = self.means @ level.T
        total = np.maximum(self.sums(self.weights), 1e-12)
        middle = np.stack([self.sums(self.weights * axis) for axis in flat.T], 1) / total[:, None]
        x, y = (flat - middle[self.owners]).T
        xx, yy, xy = (self.sums(self.weights * product) for product in (x * x, y * y, x * y))
        return 0.5 * np.arctan2(2 * xy, xx - yy)

    def _extents(self, axes: Array) -> Array:
        """[T, A] length of each thing along axes [T, A, 3]."""
        ends = self.quantiles([(1 - constants.BOX_WEIGHT) / 2, (1 + constants.BOX_WEIGHT) / 2], axes)
        return ends[..., 1] - ends[..., 0]

    def sample(self, most: int) -> PointSets:
        """Return every n-th Gaussian of each thing, about ``most`` of each."""
        counts = np.diff(self.starts)
        position = np.arange(len(self.means)) - np.repeat(self.starts[:-1], counts)
        some = position % np.repeat(np.maximum(1, counts // most), counts) == 0
        return PointSets(self.means[some], self.weights[some], np.append(0, np.cumsum(some))[self.starts])

    def sums(self, values: Array) -> Array:
        """Return the sum of values [M] over each thing, [T]."""
        return np.bincount(self.owners, values, len(self)).astype(np.float64)


def _upright(turns: Array, level: Array) -> Array:
    """Return axes [T, 3, 3]: two in the plane of directions [2, 3], turned by angles [T], and the one across it."""
    c, s = np.cos(turns)[:, None], np.sin(turns)[:, None]
    one, other = c * level[0] + s * level[1], c * level[1] - s * level[0]
    return np.stack([one, other, np.cross(one, other)], 1)


def _quantiles(
    values: Array, weights: Array, firsts: NDArray[np.int64], rows: NDArray[np.int64], shares: Sequence[float]
) -> Array:
    """[T, Q] values below which Q shares of the weight of each row lie. Values [M] are in order of their ``rows`` [M],
    which begin at ``firsts`` [T]; none is empty.

    Only values of the bin in which a quantile lies are sorted.
    """
    low, high = np.minimum.reduceat(values, firsts), np.maximum.reduceat(values, firsts)
    span = np.where(high > low, high - low, 1.0)
    bins = np.minimum((values - low[rows]) / span[rows] * BINS, BINS - 1).astype(np.int64) + rows * BINS
    sums = np.zeros((len(firsts), BINS + 1))  # of all bins before
    sums[:, 1:] = np.bincount(bins, weights, len(firsts) * BINS).reshape(-1, BINS).cumsum(1)
    quantiles = np.empty((len(firsts), len(shares)))
    for column, share in enumerate(shares):
        wanted = share * sums[:, -1]
        chosen = (sums[:, 1:-1] < wanted[:, None]).sum(1)
        below = sums[np.arange(len(firsts)), chosen]
        members = np.flatnonzero(bins == (np.arange(len(firsts)) * BINS + chosen)[rows])
        members = members[np.lexsort((values[members], rows[members]))]
        starts = np.searchsorted(rows[members], np.arange(len(firsts) + 1))
        within = np.concatenate([[0.0], np.cumsum(weights[members])])
        at = np.searchsorted(within[1:], within[starts[:-1]] + wanted - below)
        quantiles[:, column] = values[members[np.clip(at, starts[:-1], starts[1:] - 1)]]
    return quantiles
