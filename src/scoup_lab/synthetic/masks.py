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
Run = tuple[int, int, int]
"""Row, first and last column."""


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


def piece_boxes(mask: Mask, least: float) -> list[Box]:
    """Return the boxes of the connected pieces of at least ``least`` pixels."""
    labels, count = components(mask)
    sizes = np.bincount(labels.ravel(), minlength=count + 1)[1:]
    pieces = zip(ndimage.find_objects(labels), sizes, strict=True)
    return [_box_of(box) for box, size in pieces if size >= least]


def _box_of(box: tuple[slice, ...]) -> Box:
    rows, columns = box
    return columns.start, rows.start, columns.stop - 1, rows.stop - 1


def mask_polygons(mask: Mask) -> list[tuple[Polygon, Box]]:
    """Return polygons of a mask [H, W]: ``PIL.ImageDraw.polygon`` with its outline paints the mask again.

    A polygon has one run of pixels in each of its rows: one cannot have a hole. Returns for each its corners, pixels on
    its rim, and the box around the whole connected piece that it belongs to.
    """
    pieces, _ = components(mask)
    boxes = [_box_of(box) for box in ndimage.find_objects(pieces)]
    return [(_rim(runs), boxes[pieces[runs[0][:2]] - 1]) for runs in _stacks(mask)]


def _stacks(mask: Mask) -> list[list[Run]]:
    """Return the runs of a mask, cut into stacks in which each run touches only the one above and the one below."""
    stacks: list[list[Run]] = []
    above: list[list[Run]] = []  # stacks that reach the row before
    for row, pixels in enumerate(mask):
        ends = np.flatnonzero(np.diff(pixels, prepend=False, append=False)).tolist()
        runs = [(row, first, after - 1) for first, after in zip(ends[::2], ends[1::2], strict=True)]
        reached = []
        for run in runs:
            over = [stack for stack in above if _touch(stack[-1], run)]
            if len(over) == 1 and sum(_touch(over[0][-1], other) for other in runs) == 1:
                over[0].append(run)
            else:
                stacks.append([run])
                over = stacks[-1:]
            reached.append(over[0])
        above = reached
    return stacks


def _touch(upper: Run, lower: Run) -> bool:
    return upper[0] in (lower[0] - 1, lower[0]) and upper[1] <= lower[2] and lower[1] <= upper[2]


def _rim(runs: list[Run]) -> Polygon:
    """Return the corners of a stack: down along its first pixels, in steps inside it, and up along its last ones."""
    left, right = Polygon(), Polygon()
    for (row, *ends), (_, *below) in zip(runs, [*runs[1:], runs[-1]], strict=True):
        inner = max(ends[0], below[0]), min(ends[1], below[1])
        left += [(ends[0], row), (inner[0], row)]
        right += [(ends[1], row), (inner[1], row)]
        if row < runs[-1][0]:
            left.append((inner[0], row + 1))
            right.append((inner[1], row + 1))
    return _straightened([*left, *reversed(right)])


def _straightened(corners: Polygon) -> Polygon:
    """Return corners of upright and level edges without collinear ones."""
    turns = [
        corner for corner, before in zip(corners, [corners[-1], *corners], strict=False) if corner != before
    ]
    turned = []
    for number, (x, y) in enumerate(turns):
        (px, py), (nx, ny) = turns[number - 1], turns[(number + 1) % len(turns)]
        if (x - px) * (nx - x) + (y - py) * (ny - y) <= 0:
            turned.append((x, y))
    return turned or corners[:1]
