"""Features of a photograph from windows of a model's size."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

_AT_ONCE = 4


def mean_of_windows(image: Tensor, side: int, patch: int, encode: Callable[[Tensor], Tensor]) -> Tensor:
    """Return [h / patch, w / patch, C] float32 features of an image [3, h, w].

    The image (multiples of ``patch``, at least ``side``) is covered by as few windows as possible, evenly placed; where
    they overlap, the mean is taken. ``encode`` turns windows [B, 3, side, side] into [B, window, window, C].
    """
    window = side // patch
    rows, columns = image.shape[1] // patch, image.shape[2] // patch
    places = [(y, x) for y in _starts(rows, window) for x in _starts(columns, window)]
    cuts = [image[:, y * patch : (y + window) * patch, x * patch : (x + window) * patch] for y, x in places]
    with torch.inference_mode():
        features = torch.cat([encode(batch) for batch in torch.stack(cuts).split(_AT_ONCE)])
        total = features.new_zeros(rows, columns, features.shape[-1])
        count = features.new_zeros(rows, columns, 1)
        for (y, x), of_window in zip(places, features, strict=True):
            total[y : y + window, x : x + window] += of_window
            count[y : y + window, x : x + window] += 1
        return total / count


def _starts(length: int, window: int) -> list[int]:
    """Return the first places of as few windows as cover a length, evenly placed."""
    count = -(-length // window)
    if count == 1:
        return [0]
    return [(length - window) * number // (count - 1) for number in range(count)]
