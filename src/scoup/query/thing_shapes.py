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

from scoup.base.brief import brief
from scoup.base.records import rounded_vector
from scoup.scene.gaussians import Gaussians

INSIDE = 0.98
"""Share of the weight inside an oriented box along each of its axes."""
FARTHEST = 4.0
"""Gaussians farther from the middle of a thing than so many times its median distance are strays."""
SPAN = 0.96
"""Share of a thing's weight within its span along a direction."""

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class OrientedBox:
    """An oriented box in the world. Tensors are float64 on the CPU."""

    centre: Tensor
    """[3] world units."""
    axes: Tensor
    """[3, 3] one unit direction per row, right-handed, longest extent first."""
    extent: Tensor
    """[3] full lengths along the axes in world units."""

    __repr__ = brief

    def record(self) -> dict[str, Any]:
        """Return the box as plain JSON values, rounded."""
        axes = [[round(each, 6) for each in row] for row in self.axes.tolist()]
        return {
            "centre": rounded_vector(self.centre.tolist()),
            "axes": axes,
            "extent": rounded_vector(self.extent.tolist()),
        }

    def corners(self) -> Tensor:
        """Return the corners [8, 3]."""
        signs = torch.cartesian_prod(*[torch.tensor([-0.5, 0.5], dtype=torch.float64)] * 3)
        return self.centre + (signs * self.extent) @ self.axes


@dataclass(frozen=True, eq=False)
class ThingPoints:
    """The Gaussians of T things without strays, one thing after the other. M of them in all."""

    means: Array  # [M, 3]
    weights: Array  # [M] their opacities
    starts: NDArray[np.int64]  # [T + 1], where each thing starts

    @classmethod
    def of(cls, gaussians: Gaussians, members: Sequence[Tensor]) -> ThingPoints:
        """From the numbers of the Gaussians of each thing; weights are opacities."""
        rows = torch.cat([*members, torch.empty(0, dtype=torch.int64)]).cpu()
        chosen = gaussians.select(rows.to(gaussians.device)).to("cpu")
        means = chosen.means.double().numpy()
        weights = chosen.opacities.double().clamp(0, 1).numpy()
        starts = np.concatenate([[0], np.cumsum([len(each) for each in members])]).astype(np.int64)
        weights = np.where(np.isfinite(means).all(1) & np.isfinite(weights), weights, 0.0)
        means = np.where(weights[:, None] > 0, means, 0.0)
        every = cls(means, weights, starts)
        distance = np.linalg.norm(means - every.medians()[every.owners], axis=1)
        usual = cls(distance[:, None], weights, starts).quantiles([0.5])[:, 0, 0]
        near = (distance <= FARTHEST * usual[every.owners]) & (weights > 0)
        kept = np.concatenate([[0], np.cumsum(near)])[starts]
        return cls(means[near], weights[near], kept)

    @classmethod
    def of_one_thing(cls, points: Tensor, weights: Tensor) -> ThingPoints:
        """From points [M, 3] and their weights [M], some above 0; none is taken for a stray."""
        return cls(points.numpy(), weights.numpy(), np.array([0, len(points)]))

    def __len__(self) -> int:
        return len(self.starts) - 1

    @cached_property
    def owners(self) -> NDArray[np.int64]:
        """[M] the thing of each Gaussian."""
        return np.repeat(np.arange(len(self)), np.diff(self.starts))

    def of_one(self, number: int) -> Array:
        """Means of one thing."""
        return self.means[self.starts[number] : self.starts[number + 1]]

    def medians(self) -> Array:
        """[T, 3] weighted median along each axis; NaN for things without Gaussians."""
        return self.quantiles([0.5])[..., 0]

    def quantiles(self, shares: Sequence[float], axes: Array | None = None) -> Array:
        """[T, A, Q] values below which shares of each thing's weight lie, along axes [T, A, 3] of each."""
        values = self.means
        if axes is not None:
            values = np.einsum("mad,md->ma", axes[self.owners], values)
        found = np.full((len(self), values.shape[1], len(shares)), np.nan)
        filled = np.flatnonzero(np.diff(self.starts))
        owners = self.owners
        for axis in range(values.shape[1]):
            along = np.ascontiguousarray(values[:, axis])
            order = np.argsort(along) if len(self) == 1 else np.lexsort((along, owners))
            sums = np.concatenate([[0.0], np.cumsum(self.weights[order])])
            first, last = sums[self.starts[filled]], sums[self.starts[filled + 1]]
            for place, share in enumerate(shares):
                rows = np.searchsorted(sums[1:], first + share * (last - first))
                rows = rows.clip(self.starts[filled], self.starts[filled + 1] - 1)
                found[filled, axis, place] = values[order[rows], axis]
        return found

    def spans(self) -> Array:
        """[T, 3, 2] lower and upper end along each axis; NaN without Gaussians."""
        return self.quantiles([(1 - SPAN) / 2, (1 + SPAN) / 2])

    def boxes(self) -> list[OrientedBox | None]:
        """The box along the principal axes of each thing; None without Gaussians."""
        if not len(self.means):
            return [None] * len(self)
        owners, total = self.owners, np.maximum(self._sums(self.weights), 1e-12)
        middle = np.stack([self._sums(self.weights * axis) for axis in self.means.T], 1) / total[:, None]
        away = self.means - middle[owners]
        pairs = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]
        spread = np.zeros((len(self), 3, 3))
        for i, j in pairs:
            spread[:, i, j] = spread[:, j, i] = self._sums(self.weights * away[:, i] * away[:, j]) / total
        axes = np.linalg.eigh(spread)[1].transpose(0, 2, 1)[:, ::-1]
        # A direction and its opposite serve alike: take the one whose largest component is positive.
        largest = np.take_along_axis(axes, np.abs(axes).argmax(2)[..., None], 2)
        axes = axes * np.where(largest < 0, -1.0, 1.0)
        axes[:, 2] = np.cross(axes[:, 0], axes[:, 1])
        ends = self.quantiles([(1 - INSIDE) / 2, (1 + INSIDE) / 2], axes)
        centres = np.einsum("ta,tad->td", ends.mean(2), axes)
        extents = ends[..., 1] - ends[..., 0]
        return [
            OrientedBox(*map(torch.from_numpy, parts)) if np.isfinite(parts[0]).all() else None
            for parts in zip(centres, axes, extents, strict=True)
        ]

    def _sums(self, values: Array) -> Array:
        return np.bincount(self.owners, values, len(self)).astype(np.float64)
