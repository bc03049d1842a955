"""Things without training: regions of many views that the same Gaussians contribute to become one instance.

``scoup.uplift.merging`` has the rule by which regions merge. Regions are taken in the order of the names of their
views, and all sums are exact. So the same views give the same things, whether they were added at once, one by one, or
by shards. Gaussians far from the rest of their thing are strays, and leave it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from scoup.base import InputError, Progress, no_progress, spread
from scoup.field import MOST_THINGS, NO_THING, ThingTable
from scoup.scene import SparseCodes, index_dtype, linked_parts, nearest_points, normalise_embeddings
from scoup.uplift import constants
from scoup.uplift.merging import Matrix, merge_regions
from scoup.uplift.storage.entries import Entries
from scoup.uplift.stored_sums import RegionSums
from scoup.uplift.voting import vote

SAMPLED = 1000  # Gaussians of a thing, about which decide its size
FARTHEST = 1 << 14  # cells from its middle; those beyond count as there
APART = 1 << 17  # cells between the middles of two things
Numbers = NDArray[np.int64]


def find_things(
    sums: RegionSums, embeddings: Sequence[Tensor], progress: Progress = no_progress
) -> FoundThings:
    """Merge the regions of all views into things.

    A thing owns the Gaussians that contribute more to it than to others, but for strays (``find_strays``).

    Args:
        sums: of the views, with the rows of their regions among the embeddings (``RegionSums.select``).
        embeddings: per level [R, D], of the regions of all views. They do not decide what is merged.
        progress: called for the stage "things".

    Returns:
        The table of things, and how many strays were cut.

    Raises:
        InputError: the sums do not know the rows of their regions.

    Example:
        >>> gaussians, cameras = scoup.load_gaussians("scene/point_cloud.ply"), scoup.load_cameras("scene")
        >>> regions = scoup.load_regions("scene", cameras)
        >>> sums = scoup.region_sums(gaussians, cameras, regions)
        >>> found = scoup.find_things(sums, [regions.embeddings(level)[0] for level in regions.levels])
        >>> found.table.owners.shape == (len(gaussians), len(regions.levels))
        True
    """
    if sums.rows is None:
        raise InputError("the rows of each view are not known; use sums of `region_sums`, or select views")
    names = spread(sorted(sums.rows[0]), constants.MOST_VIEWS)
    entries = _strong_entries(sums, names)
    of_levels: list[_LevelThings] = []
    for number, (rows, of_level) in enumerate(zip(sums.rows, embeddings, strict=True)):
        progress("things", number, len(embeddings))
        matrix = _by_region(entries, number, len(of_level))
        view_rows = {name: rows[name] for name in names}
        of_levels.append(_things_of_level(matrix, view_rows, of_level, MOST_THINGS // len(embeddings)))
    progress("things", len(embeddings), len(embeddings))
    owners, strays = _owners(sums, of_levels), []
    if sums.means is not None:
        strays = [_drop_strays(sums, of_level, entries.total) for of_level in owners.T]
    return FoundThings(_number_things(of_levels, owners), strays)


@dataclass(frozen=True, eq=False)
class FoundThings:
    """The things of a scene."""

    table: ThingTable
    strays: list[int]
    """Per level, how many Gaussians lie apart from the thing they would belong to; [] if the means are not known."""


@dataclass(frozen=True, eq=False)
class _StrongEntries:
    """Contributions of the deciding Gaussians to regions, without weak entries."""

    gaussians: NDArray[np.int32]  # [E] in the order of the sums
    regions: NDArray[np.int32]  # [E, S] rows of the regions among those of all views, -1 for none
    weights: NDArray[np.float32]  # [E]
    total: NDArray[np.float64]  # [N] of each of these Gaussians over all views; 0 for the others


def _strong_entries(sums: RegionSums, names: Sequence[str]) -> _StrongEntries:
    """Collect the strong entries of every n-th Gaussian in the order of the sums, which is a spatial order, but for
    those that contribute little."""
    count = sums.n_gaussians
    assert sums.rows is not None
    deciding = [(name, item, *_deciding(item, count)) for name in names for item in sums.views[name].parts]
    total, largest = np.zeros(count), np.zeros(count, np.float32)
    for _, _, gaussians, weights, _ in deciding:
        starts = np.flatnonzero(np.diff(gaussians, prepend=-1))
        if len(starts):
            distinct = gaussians[starts]
            total[distinct] += np.add.reduceat(weights.astype(np.float64), starts)
            largest[distinct] = np.maximum(largest[distinct], np.maximum.reduceat(weights, starts))
    least = np.where(_decide(total), constants.LEAST_SHARE * largest, np.float32(np.inf))
    triplets = [(np.zeros(0, np.int32), np.zeros((0, len(sums.rows)), np.int32), np.zeros(0, np.float32))]
    for name, entries, gaussians, weights, combinations in deciding:
        firsts = np.array([rows[name].start for rows in sums.rows])
        strong = np.flatnonzero((weights >= least[gaussians]) & (weights > 0))
        table = np.where(entries.table >= 0, entries.table + firsts, -1).astype(np.int32)
        triplets.append((gaussians[strong], table[combinations[strong]], weights[strong]))
    gaussians, regions, weights = (np.concatenate(parts) for parts in zip(*triplets, strict=True))
    return _StrongEntries(gaussians, regions, weights, total)


def _deciding(sums: Entries, count: int) -> tuple[NDArray[np.int32], NDArray[np.float32], NDArray[np.uint16]]:
    """Return (gaussian, weight, label tuple) of the entries whose Gaussians, of ``count``, decide."""
    sums.check_numbers(count)
    gaussians = sums.gaussians().astype(np.int32)
    chosen = np.flatnonzero(gaussians % max(1, -(-count // constants.MOST_DECIDING)) == 0)
    return gaussians[chosen], sums.weights[chosen].astype(np.float32), sums.combinations[chosen]


def _decide(total: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return [N] whether a Gaussian that contributes ``total`` [N] is one of the largest, which decide."""
    order = np.argsort(-total, kind="stable")
    mass = np.cumsum(total[order])
    decides = np.zeros(len(total), bool)
    if len(mass) and mass[-1] > 0:
        decides[order[: int(np.searchsorted(mass, constants.MASS * mass[-1])) + 1]] = True
    return decides


def _by_region(entries: _StrongEntries, level: int, n_regions: int) -> Matrix:
    """Return [N, R] float32 of one level."""
    from scipy.sparse import coo_array

    region = entries.regions[:, level]
    there = region >= 0
    places = (entries.gaussians[there], region[there])
    shape = (len(entries.total), n_regions)
    matrix = coo_array((entries.weights[there], places), shape).tocsr()
    matrix.sum_duplicates()
    return matrix


@dataclass(frozen=True, eq=False)
class _LevelThings:
    """The T things of one level, largest first."""

    member: NDArray[np.int64]  # [R] thing of each region, -1 for none
    embeddings: NDArray[np.float32]  # [T, D]
    agreement: NDArray[np.float32]  # [T]
    n_regions: NDArray[np.int32]  # [T]
    mass: NDArray[np.float32]  # [T]
    stability: NDArray[np.float32]  # [T]


def _things_of_level(
    matrix: Matrix, rows: Mapping[str, slice], embeddings: Tensor, most: int
) -> _LevelThings:
    order, views = np.zeros(0, np.int64), np.zeros(0, np.int64)
    for number, name in enumerate(sorted(rows)):
        columns = np.arange(rows[name].start, rows[name].stop)
        order, views = np.append(order, columns), np.append(views, np.full(len(columns), number))
    labels = np.full(matrix.shape[1], -1)
    labels[order], stability = merge_regions(matrix[:, order], views)
    region_mass = np.asarray(matrix.sum(0)).ravel()
    sizes = np.bincount(labels[order], minlength=1)
    mass = np.bincount(labels[order], region_mass[order], len(sizes))
    things = np.flatnonzero((sizes >= constants.LEAST_REGIONS) & (mass > 0))
    things = things[np.argsort(-mass[things], kind="stable")][:most]
    numbers = np.full(len(sizes), -1)
    numbers[things] = np.arange(len(things))
    member = np.where(labels >= 0, numbers[labels], -1)
    means, agreement = mean_embeddings(embeddings, member, region_mass, len(things))
    counts = sizes[things].astype(np.int32)
    masses, stable = mass[things].astype(np.float32), stability[things].astype(np.float32)
    return _LevelThings(member, means, agreement, counts, masses, stable)


def mean_embeddings(
    embeddings: Tensor, member: NDArray[np.int64], mass: NDArray[np.floating], count: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return [T, D] float32 unit, the mean embedding of the regions of each of ``count`` things (zero if unknown), and
    [T] float32, the norm of the mean of unit embeddings, 0..1: how much they agree.

    Regions count by the square roots of their ``mass`` [R]; zero embeddings do not count.
    """
    from scipy.sparse import csr_array

    members = np.flatnonzero(member >= 0)  # few: not all views decide
    # Rounded as they are kept beside region sums, where updates read them.
    rows = normalise_embeddings(embeddings[members].cpu().half().float()).double().numpy()
    there = rows.any(1)
    rows, members = rows[there], members[there]
    weights = np.sqrt(mass[members].astype(np.float64))
    summed = csr_array((weights, (member[members], np.arange(len(rows)))), (count, len(rows))) @ rows
    total = np.bincount(member[members], weights, count)
    norm = np.linalg.norm(summed, axis=1)
    agreement = np.divide(norm, total, out=np.ones(count), where=total > 0).clip(0, 1)
    unit = summed / np.maximum(norm, 1e-300)[:, None]
    return unit.astype(np.float32), agreement.astype(np.float32)


def _owners(sums: RegionSums, of_levels: Sequence[_LevelThings]) -> NDArray[np.int64]:
    """Return [N, S], the thing per level that each Gaussian of the scene contributes to most, -1 for none.

    This is a vote in which the code of a region is its thing.
    """
    most = max(1, *(len(level.agreement) for level in of_levels))
    codes = []
    for level in of_levels:
        there = torch.from_numpy(level.member >= 0)
        indices = torch.from_numpy(level.member).clamp(min=0)[:, None].to(index_dtype(most))
        codes.append(SparseCodes(indices, there[:, None].float(), most))
    voted = vote(sums, codes, torch.ones(len(of_levels), most, 1), keep=1)
    owners = voted.indices[..., 0].numpy().astype(np.int64)
    return np.where(voted.weights[..., 0].numpy() > 0, owners, -1)


def _drop_strays(sums: RegionSums, owners: NDArray[np.int64], weights: NDArray[np.float64]) -> int:
    """Take from things [N] of one level, in the order of the scene, the Gaussians that are strays; return how many.

    ``weights`` [N] are in the order of the sums.
    """
    assert sums.means is not None
    order = sums.order.numpy()
    strays = find_strays(owners[order], sums.means.numpy(), weights)
    owners[order[strays]] = -1
    return int(strays.sum())


def _number_things(of_levels: Sequence[_LevelThings], owners: NDArray[np.int64]) -> ThingTable:
    """Number the things of all levels, level by level, and find their parents."""
    from scipy.sparse import coo_array

    sizes = [len(level.agreement) for level in of_levels]
    first = np.cumsum([0, *sizes])
    parents = np.full(first[-1], NO_THING, np.int32)
    for number in range(len(of_levels) - 1):
        fine, coarse = owners[:, number], owners[:, number + 1]
        thing_sizes = np.bincount(fine[fine >= 0], minlength=sizes[number])
        both = (fine >= 0) & (coarse >= 0)
        pairs = (np.ones(int(both.sum()), np.int64), (fine[both], coarse[both]))
        shared: Matrix = coo_array(pairs, sizes[number : number + 2]).tocsr().tocoo()  # duplicates summed
        inside = shared.data > constants.INSIDE * thing_sizes[shared.row]  # true of one parent at most
        parents[first[number] + shared.row[inside]] = first[number + 1] + shared.col[inside]
    numbered = np.where(owners >= 0, owners + first[:-1], NO_THING)
    embeddings, agreement, n_regions, mass, stability = (
        torch.from_numpy(np.concatenate([getattr(level, name) for level in of_levels]))
        for name in ("embeddings", "agreement", "n_regions", "mass", "stability")
    )
    levels = np.repeat(np.arange(len(of_levels)), sizes).astype(np.uint8)
    owned = torch.from_numpy(numbered.astype(np.int32))
    return ThingTable(
        owned,
        torch.from_numpy(levels),
        torch.from_numpy(parents),
        embeddings.half(),
        agreement,
        n_regions,
        mass,
        stability,
    )


def find_strays(
    owners: Numbers, means: NDArray[np.float32], weights: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Return [N] whether each Gaussian is a stray of the thing that owns it (-1 for none), by its place ``means`` [N,
    3] and what it contributes, ``weights`` [N].

    The body of a thing is the connected part of the cells that its Gaussians fill which weighs most. Gaussians of parts
    that weigh much less are strays.
    """
    strays = np.zeros(len(owners), bool)
    members = np.flatnonzero((owners >= 0) & np.isfinite(means).all(1))
    if not len(members):
        return strays
    members = members[np.argsort(owners[members].astype(np.min_scalar_type(owners.max())), kind="stable")]
    starts = np.flatnonzero(np.diff(owners[members], prepend=-1))
    points, weights = means[members].astype(np.float64), weights[members]
    ends = np.append(starts[1:], len(members))
    of_things = [_cells(points[a:b], weights[a:b]) for a, b in zip(starts, ends, strict=True)]
    cells = [thing << 45 | filled for thing, (filled, _) in enumerate(of_things)]
    first = np.cumsum([0, *map(len, cells)])
    cell = np.concatenate(
        [number + of_thing for number, (_, of_thing) in zip(first, of_things, strict=False)]
    )
    component = _touching_parts(np.concatenate(cells))[cell]
    weight = np.bincount(component, weights)
    of_component = np.zeros(len(weight), np.int64)
    of_component[component] = np.repeat(np.arange(len(starts)), ends - starts)
    body = np.zeros(len(starts))
    np.maximum.at(body, of_component, weight)
    strays[members] = (weight < constants.KEPT * body[of_component])[component]
    return strays


def _cells(points: NDArray[np.float64], weights: NDArray[np.float64]) -> tuple[Numbers, Numbers]:
    """Return the cells that the points [M, 3] of a thing fill, rising, and which of them is each point's [M]."""
    middle, size = _place(points, weights)
    edge = size * max(1 / constants.PER_SIZE, constants.SPACING / math.sqrt(len(points)))
    along = (points - middle) / edge
    x, y, z = (np.floor(along.clip(-FARTHEST, FARTHEST)).astype(np.int64) + FARTHEST).T
    return np.unique(x << 30 | y << 15 | z, return_inverse=True)


def _place(points: NDArray[np.float64], weights: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """Return the weighted median [3] of points [M, 3], and twice the weighted median distance from it."""
    if weights.any():
        points, weights = points[weights > 0], weights[weights > 0]
    step = max(1, len(points) // SAMPLED)
    points, weights = points[::step], weights[::step]
    middle = np.array([_median(axis, weights) for axis in points.T])
    return middle, 2 * _median(np.linalg.norm(points - middle, axis=1), weights) or 1e-100  # in any unit


def _median(values: NDArray[np.float64], weights: NDArray[np.float64]) -> float:
    order = np.argsort(values, kind="stable")
    sums = np.cumsum(weights[order])
    return float(values[order[np.searchsorted(sums, 0.5 * sums[-1])]])


def _touching_parts(filled: Numbers) -> Numbers:
    """Return the number of the connected part of each cell, by its thing and its place in 15 bits per axis."""
    cells = np.stack([filled >> shift & (1 << 15) - 1 for shift in (30, 15, 0)], 1).astype(np.float64)
    cells[:, 0] += (filled >> 45) * APART
    nearest, lengths = nearest_points(cells, min(constants.NEIGHBOURS, len(cells) - 1))
    return linked_parts(nearest, lengths, constants.TOUCHING)
