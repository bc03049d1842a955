"""Masks of answers in views: their boxes, their parts, and the point that stands for them."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from scoup.base.native import native_core

LEAST_SHARE = 0.02
"""A part of a mask with less than this share of the area of the largest part is a speck."""
AVERAGED = 7
"""Side of the box, in pixels, over which relevancy is averaged to find the most relevant pixel."""


def mask_box(mask: Tensor) -> tuple[int, int, int, int] | None:
    """Return (x0, y0, x1, y1) around the true pixels of [H, W], x1 and y1 one past the last; None of an empty mask."""
    if not mask.numel():
        return None
    bits = mask.view(torch.uint8)  # torch finds their largest much sooner than any of a boolean
    rows, columns = bits.amax(1).nonzero()[:, 0], bits.amax(0).nonzero()[:, 0]
    if not len(rows):
        return None
    return int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1


def main_parts(mask: Tensor) -> tuple[Tensor, Tensor]:
    """Return a mask [H, W] without specks, and its largest part.

    Pixels that touch at a corner are connected. Things are often seen in pieces, with something in front of them, and
    several may answer, so the largest part alone would be too little.
    """
    if not mask.any():
        return mask, mask
    parts, count = mask_parts(mask.numpy())
    areas = np.bincount(parts.ravel(), minlength=count + 1)
    areas[0] = 0
    kept = areas >= LEAST_SHARE * areas.max()
    kept[0] = False
    return torch.from_numpy(kept[parts]), torch.from_numpy(parts == areas.argmax())


def most_relevant_pixel(heat: Tensor, part: Tensor) -> tuple[int, int] | None:
    """Return (x, y) of the largest averaged relevancy [H, W] within a part [H, W]; of equals the one nearest to their
    mean; None if the part is empty.
    """
    if not part.any():
        return None
    averaged = torch.nn.functional.avg_pool2d(
        heat[None], AVERAGED, stride=1, padding=AVERAGED // 2, count_include_pad=False
    )[0]
    values = torch.where(part, averaged, -torch.inf)
    pixels = (values == values.max()).nonzero().flip(1)
    # A pixel in the middle of a plateau says more than its first corner.
    offsets = pixels.double() - pixels.double().mean(0)
    x, y = pixels[int(offsets.square().sum(1).argmin())].tolist()
    return x, y


def mask_parts(mask: NDArray[np.bool_]) -> tuple[NDArray[np.int32], int]:
    """Return the connected part of each pixel of a mask [H, W], 0 outside, and how many parts there are.

    Pixels that touch at a corner are connected. Parts are numbered from 1 by their first pixels, row by row. The
    compiled core does the work; ``plain_mask_parts`` is its specification.
    """
    core = native_core()
    if core is None:
        return plain_mask_parts(mask)
    return core.mask_parts(np.ascontiguousarray(mask).view(np.uint8))


def plain_mask_parts(mask: NDArray[np.bool_]) -> tuple[NDArray[np.int32], int]:
    """``mask_parts`` by scipy, which takes half a second to import."""
    from scipy import ndimage

    parts = np.empty(mask.shape, np.int32)
    count = int(ndimage.label(mask, np.ones((3, 3)), output=parts))  # pyright: ignore[reportArgumentType]
    return parts, count
