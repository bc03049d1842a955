"""Grids of points, and crops of the image."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
from numpy.typing import NDArray

_COARSEST = 8  # rows and columns between the first points

Box = tuple[int, int, int, int]  # x0, y0, x1, y1 in pixels, x1 and y1 one past the last


def point_grid(points_per_side: int) -> NDArray[np.float64]:
    """Return [n^2, 2] x, y in 0..1: the centres of n x n equal cells, row by row."""
    line = (np.arange(points_per_side) + 0.5) / points_per_side
    return np.stack([np.tile(line, points_per_side), np.repeat(line, points_per_side)], axis=1)


def coarse_to_fine(points_per_side: int) -> list[NDArray[np.bool_]]:
    """Return masks [n^2] of the grid's points by round: every eighth row and column, then the points in the middle of
    four, then the points in the middle of the sides between, and so on; a round may be empty."""
    y, x = np.indices((points_per_side, points_per_side)) - (_COARSEST // 2 - 1)
    step = np.gcd(np.gcd(y, x), _COARSEST)
    middle = (y // step % 2 == 1) & (x // step % 2 == 1) & (step < _COARSEST)
    rounds = (2 * np.log2(_COARSEST // step).astype(np.int64) - middle).ravel()
    return [rounds == number for number in range(2 * int(np.log2(_COARSEST)) + 1)]


def crop_boxes(height: int, width: int, layers: int, share: float) -> list[Box]:
    """Return the image itself, then 2^n x 2^n overlapping crops for each further layer n, as in SAM's code.

    Neighbours overlap by ``share`` of the shorter side in the first layer, by half of it in each next.
    """
    boxes: list[Box] = [(0, 0, width, height)]
    for layer in range(1, layers + 1):
        a_side = 2**layer
        overlap = int(share * min(height, width) * (2 / a_side))
        wide, high = (math.ceil((overlap * (a_side - 1) + length) / a_side) for length in (width, height))
        for column, row in product(range(a_side), repeat=2):
            x0, y0 = (wide - overlap) * column, (high - overlap) * row
            boxes.append((x0, y0, min(x0 + wide, width), min(y0 + high, height)))
    return boxes


def touches_inner_edge(
    corners: NDArray[np.integer], crop: Box, height: int, width: int, near: float = 20.0
) -> NDArray[np.bool_]:
    """Return [N] whether boxes [N, 4] within a crop end within ``near`` pixels of an edge of the crop that is not an
    edge of the image: they are cut off there."""
    boxes = corners + np.array([crop[0], crop[1], crop[0], crop[1]])
    near_crop = np.abs(boxes - np.array(crop)) <= near
    near_image = np.abs(boxes - np.array([0, 0, width, height])) <= near
    return np.asarray((near_crop & ~near_image).any(1), np.bool_)
