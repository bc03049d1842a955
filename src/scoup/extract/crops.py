"""Masks to the inputs of an image model: the rest black, cut to the box, squared, resized; in batches."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import torch
from torch import Tensor

from scoup.extract.masks import Masks

BATCH = 16


def mask_crops(
    image: Tensor, masks: Masks, side: int, cut_last: bool = True, batch: int = BATCH
) -> Iterator[Tensor]:
    """Yield crops [B, side, side, 3] uint8 of all masks, in order, ``batch`` at a time, on the device of the image.

    Pixels outside the mask become black; the box is centred on a black square (an odd pixel goes to the right and
    below) and resized bilinearly, as cv2.resize does, from the four neighbours of each new pixel: the cost does not
    depend on the size of the mask. ``cut_last`` leaves out the last row and column of each box, as LangSplat does (its
    boxes name the last pixel, its slices end before it).
    """
    # One number contains all colours of a pixel: looking up one is several times faster than three.
    alpha = image.new_zeros(*image.shape[:2], 1)
    pixels = torch.cat([image, alpha], dim=2).view(torch.int32)[..., 0]
    for start in range(0, len(masks), batch):
        yield _crops(pixels, masks, range(start, min(start + batch, len(masks))), side, cut_last)


def _crops(pixels: Tensor, masks: Masks, numbers: range, side: int, cut_last: bool) -> Tensor:
    """Return crops of some masks; ``pixels`` [H, W] int32 contains red, green and blue from the lowest byte up."""
    device, image_width = pixels.device, pixels.shape[1]
    boxes = torch.from_numpy(masks.boxes[numbers.start : numbers.stop].astype(np.int64)).to(device)
    x0, y0 = boxes[:, 0], boxes[:, 1]
    full_width, full_height = boxes[:, 2] - x0, boxes[:, 3] - y0
    width, height = full_width, full_height
    if cut_last:
        # Nothing would be left of a mask one pixel wide.
        width, height = (width - 1).clamp(min=1), (height - 1).clamp(min=1)
    square = torch.maximum(width, height)
    rows, row_weights = _taps(square, height, side)  # [B, side, 2]
    columns, column_weights = _taps(square, width, side)
    bits = torch.from_numpy(np.concatenate([masks.crop(number).ravel() for number in numbers])).to(device)
    areas = full_width * full_height
    corner_in_bits = areas.cumsum(0) - areas
    corner_in_image = y0 * image_width + x0
    shape = (len(numbers), side, side)

    flat = pixels.flatten()
    planes = [torch.zeros(shape, device=device) for _ in range(3)]
    for a in range(2):
        row_in_bits = corner_in_bits[:, None] + rows[..., a] * full_width[:, None]
        row_in_image = corner_in_image[:, None] + rows[..., a] * image_width
        for b in range(2):
            column = columns[:, None, :, b]
            inside = bits.index_select(0, (row_in_bits[:, :, None] + column).flatten()).view(shape)
            colors = flat.index_select(0, (row_in_image[:, :, None] + column).flatten()).view(shape)
            weight = row_weights[:, :, None, a] * column_weights[:, None, :, b] * inside
            for channel, plane in enumerate(planes):
                plane.addcmul_((colors >> 8 * channel & 255).float(), weight)
    return torch.stack(planes, dim=-1).add_(0.5).clamp_(max=255).to(torch.uint8)


def _taps(square: Tensor, length: Tensor, side: int) -> tuple[Tensor, Tensor]:
    """Return the two old pixels of each new one along an axis and their weights, [B, side, 2]; 0 in the margins."""
    margin = (square - length) // 2
    centers = torch.arange(side, device=square.device, dtype=torch.float32) + 0.5
    source = (centers * (square[:, None].float() / side) - 0.5).clamp(min=0)
    low = torch.minimum(source.floor().long(), square[:, None] - 1)
    high = torch.minimum(low + 1, square[:, None] - 1)
    share = torch.where(high > low, source - low, 0.0)
    taps = torch.stack([low, high], dim=-1) - margin[:, None, None]
    weights = torch.stack([1 - share, share], dim=-1)
    valid = (taps >= 0) & (taps < length[:, None, None])
    return taps.clamp(min=0).minimum(length[:, None, None] - 1), weights * valid
