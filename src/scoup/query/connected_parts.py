"""Connected parts of points in space."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scoup.scene import linked_parts, nearest_points

NEIGHBOURS = 8
"""Each point is linked to so many of its nearest others."""
LONGEST_LINK = 3.0
"""Links longer than this times the median are cut, so that strays fall off."""


def connected_parts(points: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the number [M] of the connected part of each point [M, 3].

    Each point is linked to its nearest others, and links much longer than usual are cut.
    """
    count = min(NEIGHBOURS, len(points) - 1)
    if count < 1:
        return np.zeros(len(points), np.int64)
    nearest, lengths = nearest_points(points, count)
    return linked_parts(nearest, lengths, LONGEST_LINK * float(np.median(lengths[:, -1])))
