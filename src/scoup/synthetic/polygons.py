"""Masks as polygons, for label files: what ``PIL.ImageDraw.polygon`` fills, outline included, is the mask
again.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from scoup.synthetic.masks import Mask, components, filled

Polygon = list[tuple[int, int]]

# Eight neighbours (row, column), clockwise from the left.
_AROUND = ((0, -1), (-1, -1), (-1, 0), (-1, 1), (0, 1), (1, 1), (1, 0), (1, -1))


def mask_polygons(mask: Mask) -> list[tuple[Polygon, tuple[int, int, int, int]]]:
    """Polygons of a mask [H, W] whose corners (x, y) are pixels on its rim.

    A piece with a hole is cut in two at the hole's row, as a polygon cannot have one.

    Returns:
        For each polygon its corners, and the box (x0, y0, x1, y1) around the connected piece it is of,
        corners inside the piece.
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
    """The connected pieces of a mask, cut into parts that have no holes; all of the mask's shape."""
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
    """Corners (x, y) of the rim of one connected piece [H, W], clockwise (Moore's tracing); straight runs
    are one
    edge."""
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
        # Look on from the empty neighbour passed last, seen from the new place.
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
