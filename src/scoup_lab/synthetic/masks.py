"""Masks: pieces, morphology (scipy's functions with the types they really have), and polygons for label files."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

Mask = NDArray[np.bool_]
Box = tuple[int, int, int, int]
"""x0, y0, x1, y1: corner pixels inside the box."""
Polygon = list[tuple[int, int]]
"""Corners (x, y)."""

# The eight neighbours (row, column) of a pixel, clockwise from the left.
_AROUND = ((0, -1), (-1, -1), (-1, 0), (-1, 1), (0, 1), (1, 1), (1, 0), (1, -1))


def components(mask: Mask) -> tuple[NDArray[np.int32], int]:
    """Return the connected pieces of a mask (by edges, not corners): [H, W] numbers from 1, 0 outside; and
    their count."""
    labels, count = cast(Any, ndimage.label(mask))
    return labels, int(count)


def grown(mask: Mask, steps: int) -> Mask:
    """Return the mask and all pixels within ``steps`` of it."""
    return np.asarray(ndimage.binary_dilation(mask, iterations=steps), bool)


def shrunk(mask: Mask, steps: int) -> Mask:
    """Return the pixels of the mask further than ``steps`` from its border; the image's edge counts as outside."""
    return np.asarray(ndimage.binary_erosion(mask, iterations=steps), bool)


def filled(mask: Mask) -> Mask:
    """Return the mask without its holes."""
    return np.asarray(ndimage.binary_fill_holes(mask), bool)


def piece_boxes(mask: Mask, least: float) -> list[Box]:
    """Return the boxes of the connected pieces of at least ``least`` pixels."""
    labels, count = components(mask)
    sizes = np.bincount(labels.ravel(), minlength=count + 1)[1:]
    return [
        (columns.start, rows.start, columns.stop - 1, rows.stop - 1)
        for (rows, columns), size in zip(ndimage.find_objects(labels), sizes, strict=True)
        if size >= least
    ]


def mask_polygons(mask: Mask) -> list[tuple[Polygon, Box]]:
    """Return polygons of a mask [H, W]: ``PIL.ImageDraw.polygon`` with its outline paints the mask again.

    Their corners are pixels on the rim. A piece with a hole is cut in two at the hole's row, because a polygon cannot
    have a hole.

    Returns for each polygon its corners, and the box around the whole connected piece that it belongs to.
    """
    polygons = []
    pieces, count = components(mask)
    for number, box in enumerate(ndimage.find_objects(pieces, count), start=1):
        rows, columns = box
        outer = (columns.start, rows.start, columns.stop - 1, rows.stop - 1)
        for part in _without_holes(pieces[box] == number):
            corners = [(x + columns.start, y + rows.start) for x, y in _rim(part)]
            polygons.append((corners, outer))
    return polygons


def _without_holes(mask: Mask) -> list[Mask]:
    """Return the connected pieces of a mask, cut into parts that have no holes; all of the mask's shape."""
    done: list[Mask] = []
    pieces, count = components(mask)
    left = [pieces == number for number in range(1, count + 1)]
    while left:
        piece = left.pop()
        holes = filled(piece) & ~piece
        if not holes.any():
            done.append(piece)
            continue
        cut = int(np.nonzero(holes)[0][0])
        for half in (np.arange(len(piece)) <= cut, np.arange(len(piece)) > cut):
            labels, count = components(piece & half[:, None])
            left += [labels == number for number in range(1, count + 1)]
    return done


def _rim(mask: Mask) -> Polygon:
    """Return the rim of one connected piece [H, W], clockwise (Moore's tracing); a straight run is one edge."""
    padded = np.pad(mask, 1)
    rows, columns = np.nonzero(padded)
    start = (int(rows[0]), int(columns[0]))  # topmost, then leftmost: nothing lies to its left
    path = [start]
    place, came_from = start, 0
    first_move: tuple[tuple[int, int], int] | None = None
    while True:
        for turn in range(1, 9):
            direction = (came_from + turn) % 8
            step = _AROUND[direction]
            if padded[place[0] + step[0], place[1] + step[1]]:
                break
        else:
            break  # a single pixel
        if (place, direction) == first_move:
            break
        first_move = first_move or (place, direction)
        place = (place[0] + step[0], place[1] + step[1])
        path.append(place)
        # Continue from the empty neighbour passed last, seen from the new place.
        came_from = (direction + 5) % 8 if direction % 2 else (direction + 6) % 8
    corners = [(column - 1, row - 1) for row, column in path]
    return _straightened(corners[:-1] if len(corners) > 1 and corners[-1] == corners[0] else corners)


def _straightened(corners: Polygon) -> Polygon:
    kept = []
    for number, (x, y) in enumerate(corners):
        (px, py), (nx, ny) = corners[number - 1], corners[(number + 1) % len(corners)]
        if (x - px, y - py) != (nx - x, ny - y):
            kept.append((x, y))
    return kept or corners[:1]
