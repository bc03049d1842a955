"""Small holes of masks are filled, small islands removed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scoup.extract.masks import Masks
from scoup.extract.overlaps import keep_by_boxes


def without_small_parts(masks: Masks, least_area: int, most_overlap: float) -> Masks:
    """Fill holes and remove islands of fewer than ``least_area`` pixels, then suppress boxes again.

    As SAM's ``postprocess_small_regions``: pixels that touch at a corner belong together; a mask of small islands
    alone keeps the largest; in the suppression the unchanged masks go first, and the result is in that order.
    """
    changed: dict[int, NDArray[np.bool_]] = {}
    corner: dict[int, tuple[int, int]] = {}
    for number in np.flatnonzero(masks.boxes[:, 2] > masks.boxes[:, 0]).tolist():
        mask, offset = _with_margin(masks, number, least_area)
        filled, removed = _fill_holes(mask, least_area), _remove_islands(mask, least_area)
        if filled or removed:
            changed[number], corner[number] = mask, offset
    cleaned = masks.replace_masks(changed, corner)
    unchanged = np.ones(len(masks), np.float32)
    unchanged[list(changed)] = 0
    return cleaned.select(keep_by_boxes(cleaned.corners(), unchanged, most_overlap))


def _with_margin(masks: Masks, number: int, least_area: int) -> tuple[NDArray[np.bool_], tuple[int, int]]:
    """Return a mask within a larger box, and the corner (x, y) of that box."""
    x0, y0, x1, y1 = masks.boxes[number].tolist()
    crop = masks.crop(number)
    # A strip of the margin has ``least_area`` pixels: a component that leaves the margin is large whatever lies beyond,
    # so that nothing outside matters.
    across, down = -(-least_area // crop.shape[0]), -(-least_area // crop.shape[1])
    left, right = min(x0, across), min(masks.size[1] - x1, across)
    top, bottom = min(y0, down), min(masks.size[0] - y1, down)
    return np.pad(crop, ((top, bottom), (left, right))), (x0 - left, y0 - top)


def _fill_holes(mask: NDArray[np.bool_], least_area: int) -> bool:
    """Fill in place; return whether there were small holes."""
    holes, small = _parts(~mask, least_area)
    mask |= small[holes]
    return bool(small.any())


def _remove_islands(mask: NDArray[np.bool_], least_area: int) -> bool:
    """Remove in place; return whether there were small islands, one that stays alone included."""
    islands, small = _parts(mask, least_area)
    any_small = bool(small.any())
    if small[1:].all():
        small[1 + np.bincount(islands[mask])[1:].argmax()] = False
    mask &= ~small[islands]
    return any_small


def _parts(pixels: NDArray[np.bool_], least_area: int) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
    """Return the connected component of each pixel, from 1, 0 for false ones, and which components are small; 0 is
    not."""
    from scipy import ndimage

    labels = np.zeros(pixels.shape, np.int32)
    ndimage.label(pixels, np.ones((3, 3)), output=labels)
    small = np.bincount(labels.ravel()) < least_area
    small[0] = False
    return labels, small
