"""Morphology of masks: scipy's functions with the types they really have."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

Mask = NDArray[np.bool_]


def components(mask: Mask) -> tuple[NDArray[np.int32], int]:
    """Connected pieces of a mask (by edges, not corners): [H, W] numbers from 1, 0 outside; and how many."""
    labels, count = cast(Any, ndimage.label(mask))
    return labels, int(count)


def grown(mask: Mask, steps: int) -> Mask:
    """The mask and all pixels within ``steps`` of it."""
    return np.asarray(ndimage.binary_dilation(mask, iterations=steps), bool)


def shrunk(mask: Mask, steps: int) -> Mask:
    """The pixels of the mask further than ``steps`` from its border; the image's edge counts as outside."""
    return np.asarray(ndimage.binary_erosion(mask, iterations=steps), bool)


def filled(mask: Mask) -> Mask:
    """The mask without its holes."""
    return np.asarray(ndimage.binary_fill_holes(mask), bool)


def patch_boxes(mask: Mask, least: float) -> list[tuple[int, int, int, int]]:
    """Boxes (x1, y1, x2, y2), corners inside, of the connected pieces of at least ``least`` pixels."""
    labels, count = components(mask)
    sizes = np.bincount(labels.ravel(), minlength=count + 1)[1:]
    return [
        (columns.start, rows.start, columns.stop - 1, rows.stop - 1)
        for (rows, columns), size in zip(ndimage.find_objects(labels), sizes, strict=True)
        if size >= least
    ]
