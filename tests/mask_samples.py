"""Random masks of many kinds, and soft images."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st
from scipy import ndimage


def random_masks(count: int, height: int, width: int, seed: int) -> np.ndarray:
    """[count, H, W] bool: blobs, boxes, copies with a shift, parts of others, scattered dots, full and empty ones."""
    rng = np.random.default_rng(seed)
    smooth = [
        ndimage.gaussian_filter(rng.normal(size=(height, width)), rng.uniform(0.5, 4)) for _ in range(6)
    ]
    masks: list[np.ndarray] = []
    for _ in range(count):
        kind = rng.integers(7)
        mask = np.zeros((height, width), bool)
        if kind == 0 or (kind in (2, 3) and not masks):
            field = smooth[rng.integers(6)]
            mask = field > np.quantile(field, rng.uniform(0.3, 0.95))
        elif kind == 1:
            y, x = rng.integers(height), rng.integers(width)
            mask[y : y + 1 + rng.integers(height), x : x + 1 + rng.integers(width)] = True
        elif kind == 2:
            mask = np.roll(masks[rng.integers(len(masks))], rng.integers(-1, 2, 2), (0, 1))
        elif kind == 3:
            mask = masks[rng.integers(len(masks))] & (smooth[rng.integers(6)] > rng.normal() * 0.05)
        elif kind == 4:
            mask = rng.random((height, width)) > rng.uniform(0.2, 0.95)
        elif kind == 5:
            mask[:] = rng.random() > 0.5
        else:
            y, x = rng.integers(height), rng.integers(width)
            mask[max(0, y - 3) : y + 3, max(0, x - 3) : x + 3] = True
            mask[y, x] = False
        masks.append(mask)
    return np.stack(masks) if masks else np.zeros((0, height, width), bool)


@st.composite
def mask_stacks(draw: st.DrawFn, most: int = 25) -> np.ndarray:
    """Random stacks, down to one pixel and no mask."""
    height, width = draw(st.integers(1, 40)), draw(st.integers(1, 40))
    return random_masks(draw(st.integers(0, most)), height, width, draw(st.integers(0, 2**31)))


def smooth_image(height: int, width: int, seed: int = 0) -> np.ndarray:
    """[H, W, 3] uint8 soft random colours of full contrast."""
    values = ndimage.gaussian_filter(np.random.default_rng(seed).random((height, width, 3)), (3, 3, 0))
    values = (values - values.min()) / (values.max() - values.min())
    return (values * 255).astype(np.uint8)
