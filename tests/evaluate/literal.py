"""The protocols of docs/evaluation.md word by word: loops over pixels, numpy only, nothing shared with the package."""

from __future__ import annotations

import numpy as np


def box(values: np.ndarray, kernel: int, border: str) -> np.ndarray:
    """Mean over a kernel x kernel window; the window of x starts at x - kernel // 2."""
    height, width = values.shape
    out = np.zeros((height, width))
    for y in range(height):
        for x in range(width):
            total, count = 0.0, 0
            for v in range(y - kernel // 2, y - kernel // 2 + kernel):
                for u in range(x - kernel // 2, x - kernel // 2 + kernel):
                    if border == "reflect":
                        total += values[mirror(v, height), mirror(u, width)]
                        count += 1
                    elif 0 <= v < height and 0 <= u < width:
                        total += values[v, u]
                        count += 1
            out[y, x] = total / count
    return out


def mirror(place: int, size: int) -> int:
    """OpenCV's BORDER_REFLECT_101: edge pixels are not repeated."""
    while size > 1 and not 0 <= place < size:
        place = -place if place < 0 else 2 * (size - 1) - place
    return place if size > 1 else 0


def masks(
    levels: np.ndarray, kernel: int, border: str, threshold: float, smoothing: int, vote: str = "inside"
):
    """Per level h' and mask, steps 1 to 3."""
    smoothed, found = [], []
    for h in levels.astype(np.float64):
        h2 = 0.5 * (h + box(h, kernel, border))
        n = (h2 - h2.min()) / (h2.max() - h2.min() + 1e-9)
        n = np.clip(2 * n - 1, 0, 1)
        mask = n > threshold
        if vote == "but last":
            mask = langsplat_smooth(mask)
        elif smoothing > 1:
            mask = box(mask.astype(float), smoothing, "inside") > 0.5
        smoothed.append(h2)
        found.append(mask)
    return np.stack(smoothed), np.stack(found)


def langsplat_smooth(mask: np.ndarray) -> np.ndarray:
    """The most frequent value (the smaller of two) in a window of 7 x 7 that ends before the last row and column."""
    height, width = mask.shape
    out = np.zeros((height, width), bool)
    for y in range(height):
        for x in range(width):
            ones, zeros = 0, 0
            for v in range(max(0, y - 3), min(y + 4, height - 1)):
                for u in range(max(0, x - 3), min(x + 4, width - 1)):
                    ones += bool(mask[v, u])
                    zeros += not mask[v, u]
            out[y, x] = ones > zeros
    return out


def iou(a: np.ndarray, b: np.ndarray) -> float:
    both, either = 0, 0
    for p, q in zip(a.ravel(), b.ravel(), strict=True):
        both += bool(p and q)
        either += bool(p or q)
    return both / either if either else 1.0


def chosen_level(smoothed: np.ndarray, masks: np.ndarray, choice: str) -> int:
    """Step 4, the first of equals: by the maximum, or by the mean inside each level's own mask unless all are empty."""
    if choice == "peak" or not masks.any():
        return int(np.argmax([h.max() for h in smoothed]))
    return int(np.argmax([h[m].mean() if m.any() else -np.inf for h, m in zip(smoothed, masks, strict=True)]))


def lerf_ovs(levels, truth, boxes, kernel, border, threshold, smoothing, vote) -> tuple[float, int, bool]:
    """(IoU, level of the mask, hit)."""
    smoothed, found = masks(levels, kernel, border, threshold, smoothing, vote)
    level = chosen_level(smoothed, found, "peak")
    averaged = [box(h.astype(np.float64), kernel, border) for h in levels]
    best = int(np.argmax([h.max() for h in averaged]))
    top = averaged[best].max()
    hit = False
    for y in range(truth.shape[0]):
        for x in range(truth.shape[1]):
            for x1, y1, x2, y2 in boxes:
                # Sums in another order may differ in the last bit.
                hit |= abs(averaged[best][y, x] - top) < 1e-12 and x1 <= x <= x2 and y1 <= y <= y2
    return iou(found[level], truth), level, bool(hit)


def mask_mean_level(levels, truth, kernel, threshold, smoothing=7) -> tuple[float, int]:
    """(IoU, level) where the level with the highest mean relevancy inside its own mask answers."""
    smoothed, found = masks(levels, kernel, "inside", threshold, smoothing)
    level = chosen_level(smoothed, found, "mask")
    return iou(found[level], truth), level


def nearest(mask: np.ndarray, width: int, height: int) -> np.ndarray:
    """The pixel under each new pixel's centre."""
    rows, columns = mask.shape
    out = np.zeros((height, width), bool)
    for y in range(height):
        for x in range(width):
            v = int((y + 0.5) * rows / height)
            u = int((x + 0.5) * columns / width)
            out[y, x] = mask[min(v, rows - 1), min(u, columns - 1)]
    return out
