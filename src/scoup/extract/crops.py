"""Masks to the pictures an image model is shown: the rest black, cut to the box, squared, resized; batched."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import torch
from torch import Tensor

from scoup.extract.masks import Masks

BATCH = 32


def mask_crops(
    image: Tensor, masks: Masks, side: int, cut_last: bool = True, batch: int = BATCH
) -> Iterator[Tensor]:
    """Crops of all masks, in order, some at a time.

    Pixels outside the mask become black; what lies in the box is centred on a black square (an odd pixel goes to the
    right and below) and resized bilinearly, as cv2.resize does, by looking up the four neighbours of each new
    pixel: the cost does not depend on the size of the mask.

    Args:
        image: [H, W, 3] uint8, on the device the work is done on.
        side: of the crops in pixels.
        cut_last: leave out the last row and column of each box, as LangSplat does (its boxes name the last pixel,
            its slices end before it).
        batch: masks at a time.

    Yields:
        [B, side, side, 3] uint8 on the same device.
    """
    for start in range(0, len(masks), batch):
        yield _crops(image, masks, range(start, min(start + batch, len(masks))), side, cut_last)


def _crops(image: Tensor, masks: Masks, numbers: range, side: int, cut_last: bool) -> Tensor:
    device = image.device
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
    ends = (full_width * full_height).cumsum(0)
    offsets = ends - full_width * full_height

    pixels = image.reshape(-1, 3)
    result = torch.zeros(len(numbers), side, side, 3, device=device)
    for a in range(2):
        for b in range(2):
            row, column = rows[:, :, None, a], columns[:, None, :, b]
            inside = bits[offsets[:, None, None] + row * full_width[:, None, None] + column]
            color = pixels[(row + y0[:, None, None]) * image.shape[1] + column + x0[:, None, None]]
            weight = row_weights[:, :, None, a] * column_weights[:, None, :, b] * inside
            result.addcmul_(color.float(), weight[..., None])
    return result.add_(0.5).clamp_(max=255).to(torch.uint8)


def _taps(square: Tensor, length: Tensor, side: int) -> tuple[Tensor, Tensor]:
    """For each new pixel along one axis, the two old ones and their weights, [B, side, 2]; 0 in the margins."""
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
