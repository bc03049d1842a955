"""The Gaussians of a field that a page shows: all of them, or fewer that stand for several neighbours each."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass, fields

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from scoup.raster import morton_codes
from scoup.scene import SH_C0, Gaussians, quats_of_rotations

MOST_GAUSSIANS = 1_000_000
"""A page shows so many, unless another number is asked for."""
_LARGEST = 2.0  # edges of a cell: larger Gaussians are not merged in it
_SHADES = 3  # of each colour channel: Gaussians of different shades are not merged
_COARSEST = 21  # level; a cell has 2^level cells of the curve along an edge
_MOST_ALPHA = 0.99
_AT_A_TIME = 1 << 15  # rows, whose covariances stay in the cache
_PAIRS = (0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)


@dataclass(frozen=True, eq=False)
class PageGaussians:
    """The M Gaussians of a page, in an order in which neighbours are near, so that what is packed compresses well."""

    gaussians: Gaussians
    rows: Tensor  # [M] int64, of the field's Gaussian whose codes and things each has


def decimate(
    gaussians: Gaussians,
    most: int = MOST_GAUSSIANS,
    owners: Tensor | None = None,  # [N] the thing of each Gaussian, if things are known
    copies: NDArray[np.int64] | None = None,  # [N] how many similar Gaussians each of a sample stands for
) -> PageGaussians:
    """Return the Gaussians of a page, at most so many; without colours that depend on the direction.

    If more can be drawn, neighbours are merged: those in one cell of a grid that are small beside the cell, of a
    similar colour, and of the same thing. Cells are as small as the number allows; those that cover most are halved
    while the number allows that. A merged Gaussian has the mean and covariance of its members, weighted by opacity
    times area, and an opacity that covers as much; its codes and things are those of the member that covers most.
    """
    rows = np.flatnonzero(drawable(gaussians))
    drawn = _Arrays.of(gaussians, rows)
    if len(rows) > most:
        weight = cover(drawn.scales, drawn.opacities) * (1 if copies is None else copies[rows])
        group = _groups(drawn, weight, None if owners is None else owners.numpy()[rows], most)
        drawn, members = _merged(drawn, weight, group, most)
        rows = rows[members]
    order = morton_codes(torch.from_numpy(drawn.means))[0].numpy().argsort(kind="stable")
    return PageGaussians(drawn.select(order).gaussians(), torch.from_numpy(rows[order]))


def drawable(gaussians: Gaussians) -> NDArray[np.bool_]:
    """Return [N]: Gaussians that can be drawn."""
    return (gaussians.finite() & (gaussians.opacities > 0) & gaussians.quats.any(1)).numpy()


def cover(scales: NDArray[np.float32], opacities: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return [N]: opacity times area, how much a Gaussian can cover, from scales [N, 3] and opacities [N]."""
    first, second, third = scales.astype(np.float64).T
    area = np.maximum(first * second, np.maximum(first, second) * third)
    return (opacities.clip(max=1) * area).clip(min=np.finfo(np.float64).tiny)


@dataclass(frozen=True, eq=False)
class _Arrays:
    """Gaussians as numpy takes them: many small steps of torch would wait for its threads."""

    means: NDArray[np.float32]
    quats: NDArray[np.float32]
    scales: NDArray[np.float32]
    opacities: NDArray[np.float32]
    colors: NDArray[np.float32]  # [N, 3] coefficients of degree 0

    @classmethod
    def of(cls, gaussians: Gaussians, rows: NDArray[np.int64]) -> _Arrays:
        parts = gaussians.means, gaussians.quats, gaussians.scales, gaussians.opacities, gaussians.sh[:, 0]
        return cls(*(tensor.numpy()[rows] for tensor in parts))

    def select(self, rows: NDArray[np.int64] | slice) -> _Arrays:
        return _Arrays(*(getattr(self, field.name)[rows] for field in fields(self)))

    def gaussians(self) -> Gaussians:
        parts = self.means, self.quats, self.scales, self.opacities, self.colors[:, None]
        return Gaussians(*map(torch.from_numpy, parts))

    def covariances(self) -> NDArray[np.float32]:
        """Return [6, N]: xx, yy, zz, xy, xz, yz."""
        w, x, y, z = (self.quats / np.linalg.norm(self.quats, axis=1, keepdims=True)).T
        a, b, c = self.scales.T
        rows = (
            ((1 - 2 * (y * y + z * z)) * a, 2 * (x * y - w * z) * b, 2 * (x * z + w * y) * c),
            (2 * (x * y + w * z) * a, (1 - 2 * (x * x + z * z)) * b, 2 * (y * z - w * x) * c),
            (2 * (x * z - w * y) * a, 2 * (y * z + w * x) * b, (1 - 2 * (x * x + y * y)) * c),
        )
        return np.stack([sum(p * q for p, q in zip(rows[i], rows[j], strict=True)) for i, j in _PAIRS])


def _groups(
    drawn: _Arrays, weight: NDArray[np.float64], owners: NDArray[np.integer] | None, most: int
) -> NDArray[np.int64]:
    """Return [N] numbers from 0 of the groups to merge, at most so many unless the coarsest cells hold more."""
    codes, unit = morton_codes(torch.from_numpy(drawn.means))
    shades = ((SH_C0 * drawn.colors + 0.5).clip(0, 1) * _SHADES).astype(np.int32).clip(max=_SHADES - 1)
    kinds = shades @ np.array([1, _SHADES, _SHADES**2], np.int32)
    if owners is not None:
        kinds += _SHADES**3 * (1 + owners.astype(np.int32))
    order = codes.numpy().argsort(kind="stable")
    if kinds.max() < 1 << 16:  # numpy sorts 16 bits in one pass
        kinds = kinds.astype(np.uint16)
    order = order[kinds[order].argsort(kind="stable")]  # by kind, then by code
    code, kind, largest = codes.numpy()[order], kinds[order], drawn.scales.max(1)[order]

    def cells(level: int) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Return masks in this order: the Gaussians that may be merged, and among them the first of each group."""
        fits = largest <= _LARGEST * unit * 2.0**level
        cell, cell_kind = code[fits] >> 3 * level, kind[fits]
        begins = np.ones(len(cell), bool)
        begins[1:] = (cell[1:] != cell[:-1]) | (cell_kind[1:] != cell_kind[:-1])
        return fits, begins

    def count(level: int) -> int:
        fits, begins = cells(level)
        return int(begins.sum()) + len(fits) - len(begins)

    def numbered(level: int) -> NDArray[np.int64]:
        """Return the groups at a level; Gaussians that may not be merged come last."""
        fits, begins = cells(level)
        numbers, alone = np.empty(len(fits), np.int64), order[~fits]
        numbers[order[fits]] = begins.cumsum() - 1
        numbers[alone] = begins.sum() + np.arange(len(alone))
        return numbers

    level = bisect_left(range(_COARSEST), True, key=lambda level: count(level) <= most)
    group = numbered(level)
    if level > 0 and group.max() < most:
        heaviest = (-np.bincount(group, weight)).argsort(kind="stable")
        group = _halved(group, numbered(level - 1), heaviest, most)
    return group


def _halved(
    group: NDArray[np.int64], finer: NDArray[np.int64], heaviest: NDArray[np.int64], most: int
) -> NDArray[np.int64]:
    """Return [N] the groups with as many of the heaviest as possible in place of finer ones, which lie in one each."""
    count = len(heaviest)
    inside = np.zeros(finer.max() + 1, np.int64)
    inside[finer] = group
    more = np.bincount(inside, minlength=count) - 1
    halved = np.zeros(count, bool)
    halved[heaviest] = more[heaviest].cumsum() <= most - count
    chosen = np.where(halved[group], count + finer, group)
    used = np.zeros(count + len(inside), np.int64)
    used[chosen] = 1
    return (used.cumsum() - 1)[chosen]


def _merged(
    drawn: _Arrays, weight: NDArray[np.float64], group: NDArray[np.int64], most: int
) -> tuple[_Arrays, NDArray[np.int64]]:
    """Return the merged Gaussians of the heaviest groups, and [M] the heaviest member of each."""
    sizes, total = np.bincount(group), np.bincount(group, weight)
    heaviest = np.zeros(len(sizes))
    np.maximum.at(heaviest, group, weight)
    first = np.flatnonzero(weight == heaviest[group])[::-1]
    members = np.empty(len(sizes), np.int64)
    members[group[first]] = first  # of equals, the one written last

    def mean(values: NDArray[np.floating]) -> NDArray[np.float64]:
        return np.bincount(group, weight * values, len(sizes)) / total

    means = np.stack([mean(column) for column in drawn.means.T], 1)
    colors = np.stack([mean(column) for column in drawn.colors.T], 1)
    spreads = np.empty((6, len(group)), np.float32)
    for start in range(0, len(group), _AT_A_TIME):
        rows = slice(start, start + _AT_A_TIME)
        x, y, z = (drawn.means[rows] - means[group[rows]]).astype(np.float32).T
        spreads[:, rows] = drawn.select(rows).covariances() + np.stack(
            [x * x, y * y, z * z, x * y, x * z, y * z]
        )
    xx, yy, zz, xy, xz, yz = (mean(spread) for spread in spreads)

    chosen = np.sort((-total).argsort(kind="stable")[:most])
    merged = drawn.select(members[chosen])
    many = np.flatnonzero(sizes[chosen] > 1)
    groups = chosen[many]
    covariances = np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], 1)[groups].reshape(-1, 3, 3)
    variances, axes = np.linalg.eigh(covariances)
    axes[:, :, 0] *= np.sign(np.linalg.det(axes))[:, None]
    scales = np.sqrt(variances.clip(min=0))
    merged.means[many] = means[groups]
    merged.quats[many] = quats_of_rotations(torch.from_numpy(axes)).numpy()
    merged.scales[many] = scales
    with np.errstate(divide="ignore"):
        merged.opacities[many] = (total[groups] / (scales[:, 1] * scales[:, 2])).clip(max=_MOST_ALPHA)
    merged.colors[many] = colors[groups]
    return merged, members[chosen]
