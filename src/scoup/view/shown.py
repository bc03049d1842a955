"""The Gaussians of a field that the page shows, and their order."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from scoup.scene.gaussians import Gaussians

MOST_GAUSSIANS = 1_000_000
"""A page shows so many, unless another number is asked for."""
_MORTON_BITS = 21  # of each axis; three of them fit into 64 bits
_MORTON_STEPS = (
    (32, 0x1F00000000FFFF),
    (16, 0x1F0000FF0000FF),
    (8, 0x100F00F00F00F00F),
    (4, 0x10C30C30C30C30C3),
    (2, 0x1249249249249249),
)


def shown_rows(gaussians: Gaussians, most: int = MOST_GAUSSIANS) -> Tensor:
    """Return int64 [M]: the Gaussians of a page, at most so many: of those that can be drawn, the most opaque and
    largest.

    Gaussians near to each other are near in the order, so that what is packed of them compresses well.

    Args:
        gaussians: of the field, on the CPU.
        most: 1 or more.
    """
    drawable = gaussians.finite() & (gaussians.opacities > 0)
    rows = drawable.nonzero()[:, 0]
    if len(rows) > most:
        largest = gaussians.scales[rows].double().sort(1, descending=True).values[:, :2]
        weight = gaussians.opacities[rows].double().clamp(max=1) * largest.prod(1)
        rows = rows[weight.argsort(descending=True, stable=True)[:most]]
    order = np.argsort(morton_codes(gaussians.means[rows].double().numpy()), kind="stable")
    return rows[torch.from_numpy(order)]


def morton_codes(points: NDArray[np.float64]) -> NDArray[np.uint64]:
    """Return places of points [M, 3] along a Z-order curve through their bounding box; near places are near points."""
    if not len(points):
        return np.zeros(0, np.uint64)
    low, high = points.min(0), points.max(0)
    cells = (points - low) / np.where(high > low, high - low, 1.0) * (2**_MORTON_BITS - 1)
    spread = cells.astype(np.uint64)
    for shift, mask in _MORTON_STEPS:
        spread = (spread | (spread << np.uint64(shift))) & np.uint64(mask)
    return spread[:, 0] | (spread[:, 1] << np.uint64(1)) | (spread[:, 2] << np.uint64(2))
