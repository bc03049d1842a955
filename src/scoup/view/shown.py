"""The Gaussians of a field that a page shows: all of them, or fewer, of which each stands for several neighbours."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from scoup.raster import morton_codes, restored
from scoup.scene.gaussians import SH_C0, Gaussians
from scoup.scene.rotations import quats_of_rotations, rotation_matrices

MOST_GAUSSIANS = 1_000_000
"""A page shows so many, unless another number is asked for."""
COARSE_GAUSSIANS = 60_000
"""The first picture of a large scene shows so many: about 2 MB."""
_LARGEST = 2.0  # edges of a cell: larger Gaussians are not merged in it
_SHADES = 3  # of each colour channel: Gaussians of different shades are not merged
_COARSEST = 21  # level; a cell has 2^level cells of the curve along an edge
_MOST_ALPHA = 0.99
_AT_A_TIME = 1 << 20  # rows in double precision


@dataclass(frozen=True, eq=False)
class Shown:
    """The M Gaussians of a page, in an order in which neighbours are near, so that what is packed compresses well."""

    gaussians: Gaussians
    rows: Tensor  # [M] int64, of the field's Gaussian whose codes and things each has


def shown_gaussians(gaussians: Gaussians, most: int = MOST_GAUSSIANS, owners: Tensor | None = None) -> Shown:
    """Return the Gaussians of a page, at most so many; without colours that depend on the direction.

    If more can be drawn, neighbours are merged: those in one cell of a grid that are small beside the cell, of a
    similar colour, and of the same thing. Cells are as small as the number allows; those that cover most are halved
    while the number allows that. A merged Gaussian has the mean and covariance of its members, weighted by opacity
    times area, and an opacity that covers as much; its codes and things are those of the member that covers most.

    Args:
        gaussians: of the field, on the CPU.
        most: 1 or more.
        owners: [N] integers, the thing of each Gaussian, if things are known.
    """
    drawable = gaussians.finite() & (gaussians.opacities > 0) & gaussians.quats.any(1)
    rows = drawable.nonzero()[:, 0]
    drawn = gaussians.select(rows)
    drawn = replace(drawn, sh=drawn.sh[:, :1])
    if len(rows) > most:
        weight = cover(drawn)
        group = _groups(drawn, weight, None if owners is None else owners[rows], most)
        drawn, members = _merged(drawn, weight, group, most)
        rows = rows[members]
    order = morton_codes(drawn.means)[0].argsort(stable=True)
    return Shown(drawn.select(order), rows[order])


def _groups(drawn: Gaussians, weight: Tensor, owners: Tensor | None, most: int) -> Tensor:
    """Return [N] int64 numbers from 0 of the groups to merge, at most so many unless the coarsest cells hold more."""
    code, unit = morton_codes(drawn.means)
    shades = ((SH_C0 * drawn.sh[:, 0].double() + 0.5).clamp(0, 1) * _SHADES).long().clamp(max=_SHADES - 1)
    kinds = shades @ torch.tensor([1, _SHADES, _SHADES**2])
    if owners is not None:
        kinds += _SHADES**3 * owners.long()
    order = torch.from_numpy(np.lexsort((code.numpy(), kinds.numpy())))
    code, kinds, largest = code[order], kinds[order], drawn.scales.amax(1)[order].double()

    def cells(level: int) -> tuple[Tensor, int]:
        """Return the numbers of the groups in this order, and how many there are."""
        fits = (largest <= _LARGEST * unit * 2.0**level).nonzero()[:, 0]
        cell, own = code[fits] >> 3 * level, kinds[fits]
        begins = torch.ones(len(fits), dtype=torch.int64)
        begins[1:] = (cell[1:] != cell[:-1]) | (own[1:] != own[:-1])
        numbers = torch.zeros(len(code), dtype=torch.int64)
        n_cells = int(begins.sum())
        alone = torch.ones(len(code), dtype=torch.bool)
        alone[fits] = False
        numbers[fits] = begins.cumsum(0) - 1
        numbers[alone] = n_cells + torch.arange(len(code) - len(fits))
        return numbers, n_cells + len(code) - len(fits)

    level = bisect_left(range(_COARSEST), True, key=lambda level: cells(level)[1] <= most)
    group, count = cells(level)
    if level > 0 and count <= most:
        finer, n_finer = cells(level - 1)
        heaviest = group.bincount(weight[order], count).argsort(descending=True, stable=True)
        group = _halved(group, finer, n_finer, heaviest, most)
    return restored(group, order)


def _halved(group: Tensor, finer: Tensor, n_finer: int, heaviest: Tensor, most: int) -> Tensor:
    """Return [N] the groups with as many of the heaviest as possible in place of finer ones, which lie in one each."""
    count = len(heaviest)
    inside = torch.zeros(n_finer, dtype=torch.int64)
    inside[finer] = group
    more = inside.bincount(minlength=count) - 1
    halved = torch.zeros(count, dtype=torch.bool)
    halved[heaviest] = more[heaviest].cumsum(0) <= most - count
    chosen = torch.where(halved[group], count + finer, group)
    used = torch.zeros(count + n_finer, dtype=torch.int64)
    used[chosen] = 1
    return (used.cumsum(0) - 1)[chosen]


def _merged(drawn: Gaussians, weight: Tensor, group: Tensor, most: int) -> tuple[Gaussians, Tensor]:
    """Return the merged Gaussians of the heaviest groups, and [M] the heaviest member of each."""
    sizes = group.bincount()
    count, total = len(sizes), group.bincount(weight)
    heaviest = torch.zeros(count, dtype=torch.float64).scatter_reduce(0, group, weight, "amax")
    first = (weight == heaviest[group]).nonzero()[:, 0]
    members = torch.full((count,), len(group)).scatter_reduce(0, group[first], first, "amin")

    def mean(values: Tensor) -> Tensor:
        summed = torch.zeros(count, *values.shape[1:], dtype=torch.float64)
        for part in torch.arange(len(group)).split(_AT_A_TIME):
            summed.index_add_(0, group[part], weight[part, None] * values[part].double())
        return summed / total[:, None]

    means = mean(drawn.means)
    covariances = torch.zeros(count, 3, 3, dtype=torch.float64)
    for part in (sizes[group] > 1).nonzero()[:, 0].split(_AT_A_TIME):
        axes = rotation_matrices(drawn.quats[part].double()) * drawn.scales[part].double()[:, None]
        aside = drawn.means[part].double() - means[group[part]]
        spread = axes @ axes.mT + aside[:, :, None] * aside[:, None]
        covariances.index_add_(0, group[part], weight[part, None, None] * spread)

    chosen = total.argsort(descending=True, stable=True)[:most].sort().values
    found = drawn.select(members[chosen])
    many = (sizes[chosen] > 1).nonzero()[:, 0]
    own = chosen[many]
    variances, axes = torch.linalg.eigh(covariances[own] / total[own, None, None])
    axes[:, :, 0] *= torch.linalg.det(axes).sign()[:, None]
    scales = variances.clamp(min=0).sqrt()
    found.means[many] = means[own].float()
    found.quats[many] = quats_of_rotations(axes).float()
    found.scales[many] = scales.float()
    area = scales[:, 1] * scales[:, 2]
    found.opacities[many] = (total[own] / area).clamp(max=_MOST_ALPHA).float()
    found.sh[many, 0] = mean(drawn.sh[:, 0])[own].float()
    return found, members[chosen]


def cover(gaussians: Gaussians) -> Tensor:
    """Return [N] float64: opacity times area, how much a Gaussian can cover."""
    first, second, third = gaussians.scales.double().unbind(1)
    area = torch.maximum(first * second, torch.maximum(first, second) * third)
    return (gaussians.opacities.double().clamp(max=1) * area).clamp(min=torch.finfo(torch.float64).tiny)
