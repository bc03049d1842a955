"""Box means as a loop over pixels."""

from __future__ import annotations

import numpy as np


def reflect101(position: int, size: int) -> int:
    """cv2.borderInterpolate for BORDER_REFLECT_101, literally."""
    if size == 1:
        return 0
    while not 0 <= position < size:
        position = -position if position < 0 else 2 * (size - 1) - position
    return position


def literal_box_mean(image: np.ndarray, kernel: int, border: str) -> np.ndarray:
    height, width = image.shape
    out = np.zeros((height, width))
    for y in range(height):
        for x in range(width):
            rows = [y + offset - kernel // 2 for offset in range(kernel)]
            columns = [x + offset - kernel // 2 for offset in range(kernel)]
            if border == "reflect":
                rows = [reflect101(row, height) for row in rows]
                columns = [reflect101(column, width) for column in columns]
            else:
                rows = [row for row in rows if 0 <= row < height]
                columns = [column for column in columns if 0 <= column < width]
            out[y, x] = np.mean(image[np.ix_(rows, columns)])
    return out
