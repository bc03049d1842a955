"""Clean-up of masks: small holes are filled, small islands removed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scoup.extract.masks import Masks
from scoup.extract.overlaps import keep_by_boxes

_EIGHT = np.ones((3, 3), np.int8)  # neighbours over corners count, as in SAM's code


def without_small_parts(masks: Masks, least_area: int, most_overlap: float) -> Masks:
    """Fill holes and remove islands of fewer than ``least_area`` pixels, then suppress boxes anew.

    As SAM's ``postprocess_small_regions``: a mask of small islands alone keeps the largest; in the suppression the
    masks that needed nothing go first, and the result is in that order.

    Args:
        most_overlap: intersection over union of boxes that is still kept.
    """
    changed: dict[int, NDArray[np.bool_]] = {}
    corner: dict[int, tuple[int, int]] = {}
    for number in range(len(masks)):
        found = _cleaned(masks, number, least_area)
        if found is not None:
            changed[number], corner[number] = found
    cleaned = masks.replaced(changed, corner)
    scores = np.ones(len(masks))
    scores[list(changed)] = 0
    return cleaned.select(keep_by_boxes(cleaned.corners(), scores, most_overlap))


def _cleaned(masks: Masks, number: int, least_area: int) -> tuple[NDArray[np.bool_], tuple[int, int]] | None:
    """The mask within a box around it, and that box's corner (x, y); None if there is nothing to clean."""
    x0, y0, x1, y1 = masks.boxes[number].tolist()
    if x0 == x1:
        return None
    crop = masks.crop(number)
    # What lies outside the box is at least one long strip. With a margin that holds ``least_area`` pixels a part
    # that leaves the margin is large whatever lies beyond, so that nothing outside need be looked at.
    across, down = -(-least_area // crop.shape[0]), -(-least_area // crop.shape[1])
    left, right = min(x0, across), min(masks.size[1] - x1, across)
    top, bottom = min(y0, down), min(masks.size[0] - y1, down)
    padded = np.pad(crop, ((top, bottom), (left, right)))
    filled = _without_small(~padded, least_area)
    holes = filled is not None
    result = ~filled if filled is not None else padded
    kept = _without_small(result, least_area, keep_largest=True)
    if kept is None and not holes:
        return None
    return (result if kept is None else kept), (x0 - left, y0 - top)


def _without_small(
    parts: NDArray[np.bool_], least_area: int, keep_largest: bool = False
) -> NDArray[np.bool_] | None:
    """The connected parts of at least ``least_area`` pixels; None if none is smaller."""
    from scipy import ndimage

    labels = np.zeros(parts.shape, np.int32)
    count = int(ndimage.label(parts, _EIGHT, output=labels))  # pyright: ignore[reportArgumentType]
    sizes = np.bincount(labels.ravel(), minlength=count + 1)
    keep = sizes >= least_area
    keep[0] = False
    if keep.sum() == count:
        return None
    if keep_largest and not keep.any():
        keep[1 + int(sizes[1:].argmax())] = True
    return keep[labels]
