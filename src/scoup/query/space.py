"""Points in space: their connected parts, and places as records."""

from __future__ import annotations

from bisect import bisect_left
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from scoup.base.records import rounded_vector
from scoup.query.thing_shapes import OrientedBox
from scoup.raster import morton_codes
from scoup.scene.neighbours import linked_parts, nearest_points

NEIGHBOURS = 8
"""Each point is linked to so many of its nearest others."""
LONGEST_LINK = 3.0
"""Links longer than this times the median are cut, so that strays fall off."""

MOST_LINKED = 8192
"""Of more points than these, the cells of a grid are linked instead."""


def metres_record(
    position: Tensor | None, box: OrientedBox | None, metres_per_unit: float | None
) -> dict[str, Any]:
    """Return a place in metres as plain JSON values; nothing if it, or the length of the scene's unit, is not known."""
    if position is None or box is None or metres_per_unit is None:
        return {}
    return {
        "position_metres": rounded_vector((position * metres_per_unit).tolist()),
        "extent_metres": rounded_vector((box.extent * metres_per_unit).tolist()),
    }


def connected_parts(points: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the number [M] of the connected part of each point [M, 3].

    Each point is linked to its nearest others, and links much longer than usual are cut.
    """
    count = min(NEIGHBOURS, len(points) - 1)
    if count < 1:
        return np.zeros(len(points), np.int64)
    nearest, lengths = nearest_points(points, count)
    return linked_parts(nearest, lengths, LONGEST_LINK * float(np.median(lengths[:, -1])))


def rough_parts(points: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return ``connected_parts`` of points [M, 3], or where they are many, of the cells of a grid that they fill."""
    if len(points) <= MOST_LINKED:
        return connected_parts(points)
    places, order = morton_codes(torch.from_numpy(points))[0].sort()
    differing = places[1:] ^ places[:-1]
    coarser = bisect_left(
        range(21), True, key=lambda step: int((differing >> 3 * step > 0).sum()) < MOST_LINKED
    )
    cells = torch.empty_like(order)
    cells[order] = torch.nn.functional.pad(differing >> 3 * coarser > 0, (1, 0)).cumsum(0)
    own = cells.numpy()
    middles = np.stack([np.bincount(own, axis) for axis in points.T], 1) / np.bincount(own)[:, None]
    return connected_parts(middles)[own]
