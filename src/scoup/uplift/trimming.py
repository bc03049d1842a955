"""Strays: Gaussians that a thing owns although they lie apart from its body."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scoup.scene import linked_parts, nearest_points
from scoup.uplift import constants

SAMPLED = 1000  # Gaussians of a thing, about which decide its size
FARTHEST = 1 << 14  # cells from its middle; those beyond count as there
APART = 1 << 17  # cells between the middles of two things

Numbers = NDArray[np.int64]


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
    members = members[np.argsort(owners[members], kind="stable")]
    things, starts, thing = np.unique(owners[members], return_index=True, return_inverse=True)
    points, weights = means[members].astype(np.float64), weights[members]
    ends = np.append(starts[1:], len(members))
    places = [_place(points[a:b], weights[a:b]) for a, b in zip(starts, ends, strict=True)]
    middles, sizes = np.array([middle for middle, _ in places]), np.array([size for _, size in places])
    edges = sizes * np.maximum(1 / constants.PER_SIZE, constants.SPACING / np.sqrt(ends - starts))
    along = (points - middles[thing]) / edges[thing][:, None]
    cells = np.floor(along.clip(-FARTHEST, FARTHEST)).astype(np.int64) + FARTHEST
    keys = thing << 45 | cells[:, 0] << 30 | cells[:, 1] << 15 | cells[:, 2]
    filled, cell = np.unique(keys, return_inverse=True)
    component = _touching_parts(filled)[cell]
    weight = np.bincount(component, weights)
    of_component = np.zeros(len(weight), np.int64)
    of_component[component] = thing
    body = np.zeros(len(things))
    np.maximum.at(body, of_component, weight)
    strays[members] = (weight < constants.KEPT * body[of_component])[component]
    return strays


def _place(points: NDArray[np.float64], weights: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """Return the weighted median [3] of points [M, 3], and twice the weighted median distance from it."""
    if weights.any():
        points, weights = points[weights > 0], weights[weights > 0]
    step = max(1, len(points) // SAMPLED)
    points, weights = points[::step], weights[::step]
    middle = np.array([_median(axis, weights) for axis in points.T])
    return middle, max(2 * _median(np.linalg.norm(points - middle, axis=1), weights), 1e-12)


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
