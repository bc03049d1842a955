"""From the ideal pinhole image to the photograph a distorting lens took."""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn.functional import grid_sample

from scoup.scene import Camera


def photograph_pixels(camera: Camera, width: int, height: int) -> Tensor:
    """Map each pixel of the ideal pinhole camera to its position in the photograph.

    Args:
        camera: its K, size and distortion (k1, k2, p1, p2), OpenCV's model.
        width, height: size of the photograph (or of a map made from it), which may differ from the camera's.

    Returns:
        [camera.height, camera.width, 2] float64 positions (x, y) in pixels of the photograph, pixel
        centres at +0.5; NaN where the lens model folds back on itself.
    """
    k1, k2, p1, p2 = (*camera.distortion, 0.0, 0.0, 0.0, 0.0)[:4]
    column = torch.arange(camera.width, dtype=torch.float64) + 0.5
    row = torch.arange(camera.height, dtype=torch.float64) + 0.5
    x = ((column - camera.cx) / camera.fx)[None, :]
    y = ((row - camera.cy) / camera.fy)[:, None]
    squared = x * x + y * y
    radial = 1.0 + squared * (k1 + squared * k2)
    distorted_x = x * radial + 2.0 * p1 * x * y + p2 * (squared + 2.0 * x * x)
    distorted_y = y * radial + p1 * (squared + 2.0 * y * y) + 2.0 * p2 * x * y
    position = torch.stack(
        [
            (distorted_x * camera.fx + camera.cx) * (width / camera.width),
            (distorted_y * camera.fy + camera.cy) * (height / camera.height),
        ],
        dim=-1,
    )
    position[squared >= _fold(k1, k2)] = torch.nan
    return position


def sample_nearest(values: Tensor, positions: Tensor, outside: int) -> Tensor:
    """Return the pixel of ``values`` [h, w] under each position [H, W, 2]; ``outside`` elsewhere. [H, W]."""
    height, width = values.shape
    inside = _inside(positions, width, height)
    cells = torch.where(inside[..., None], positions, 0.0).floor().long()
    return torch.where(inside, values[cells[..., 1], cells[..., 0]], outside)


def sample_bilinear(image: Tensor, positions: Tensor) -> Tensor:
    """Interpolate ``image`` [h, w, C] uint8 at positions [H, W, 2]; black outside. Returns [H, W, C] uint8."""
    height, width = image.shape[:2]
    inside = _inside(positions, width, height)[..., None]
    size = torch.tensor([width, height], dtype=torch.float64)
    grid = (2.0 * torch.where(inside, positions, 0.0) / size - 1.0).float()
    pixels = image.permute(2, 0, 1).float()
    blended = grid_sample(pixels[None], grid[None], padding_mode="border", align_corners=False)[0]
    blended = blended.permute(1, 2, 0).round().clamp(0, 255).to(torch.uint8)
    return torch.where(inside, blended, torch.zeros_like(blended))


def _inside(positions: Tensor, width: int, height: int) -> Tensor:
    x, y = positions[..., 0], positions[..., 1]
    return (x >= 0) & (x < width) & (y >= 0) & (y < height)


def _fold(k1: float, k2: float) -> float:
    """Return the squared radius at which the radial polynomial stops growing; beyond it the model is wrong."""
    # d/dr of r (1 + k1 r^2 + k2 r^4) is 1 + 3 k1 u + 5 k2 u^2 with u = r^2; its smallest positive root.
    if k2 == 0.0:
        return -1.0 / (3.0 * k1) if k1 < 0 else math.inf
    root = 9.0 * k1 * k1 - 20.0 * k2
    if root < 0:
        return math.inf
    candidates = [(-3.0 * k1 + sign * math.sqrt(root)) / (10.0 * k2) for sign in (-1.0, 1.0)]
    return min((value for value in candidates if value > 0), default=math.inf)
