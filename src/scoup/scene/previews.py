"""Small pictures of scene data for notebooks, drawn without the rasteriser."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from scoup.base import PREVIEW

MOST_POINTS = 200_000
_MIDDLE = (0.02, 0.98)  # what lies beyond these quantiles of the means is not shown
_GREY = 245


def points_preview(points: Tensor, colors: Tensor) -> NDArray[np.uint8]:
    """Return finite points [M, 3] in their colours 0..1, seen along the direction in which they spread least: [H, W,
    3]."""
    width, height = PREVIEW
    picture = np.full((height, width, 3), _GREY, np.uint8)
    step = max(1, -(-len(points) // MOST_POINTS))
    means, pixels = points[::step].cpu().double(), (colors[::step].cpu() * 255).round().to(torch.uint8)
    if not len(means):
        return picture
    across, down, depth = _principal(means)
    x, y = _fitted(across, down, width, height)
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    order = depth.argsort(stable=True)  # far ones first
    order = order[inside[order]]
    picture[y[order].numpy(), x[order].numpy()] = pixels[order].numpy()
    return picture


def cameras_preview(viewmats: Tensor) -> NDArray[np.uint8]:
    """Draw positions and view directions of cameras [C, 4, 4] world-to-camera from above: [H, W, 3]. Up is the up
    direction of most images.
    """
    from PIL import Image, ImageDraw

    width, height = PREVIEW
    canvas = Image.new("RGB", (width, height), (_GREY,) * 3)
    if not len(viewmats):
        return np.asarray(canvas)
    turns = viewmats[:, :3, :3]
    places = -(turns.mT @ viewmats[:, :3, 3:])[..., 0]
    forward, up = turns[:, 2], -turns[:, 1].mean(0)
    axis = int(up.abs().argmin())
    right = torch.linalg.cross(torch.eye(3, dtype=torch.float64)[axis], up)
    right = right / right.norm().clamp(min=1e-9)
    ahead = torch.linalg.cross(right, up / up.norm().clamp(min=1e-9))
    plan = torch.stack([right, ahead], 1)
    flat, aim = places @ plan, forward @ plan
    x, y = _fitted(flat[:, 0], flat[:, 1], width, height)
    draw = ImageDraw.Draw(canvas)
    for column, row, (dx, dy) in zip(x.tolist(), y.tolist(), aim.tolist(), strict=True):
        draw.line((column, row, column + 14 * dx, row + 14 * dy), fill=(60, 110, 190))
        draw.ellipse((column - 2, row - 2, column + 2, row + 2), fill=(30, 30, 30))
    return np.asarray(canvas)


def labels_preview(labels: Tensor) -> NDArray[np.uint8]:
    """Return regions [H, W] in colours of their own, black where there is none: [H, W, 3], no larger than a card's
    picture."""
    from PIL import Image

    numbers = labels.cpu().numpy().astype(np.int64)
    hues = np.stack([numbers * 103 % 256, 140 + numbers * 37 % 100, 180 + numbers * 59 % 76], -1)
    hues[numbers < 0] = 0
    image = Image.fromarray(hues.astype(np.uint8), "HSV").convert("RGB")
    image.thumbnail(PREVIEW, Image.Resampling.NEAREST)
    return np.asarray(image)


def _principal(means: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return positions [M, 3] along the axes in which they spread most, less, and least."""
    ends = torch.quantile(
        means[:: max(1, len(means) // 100_000)], torch.tensor(_MIDDLE, dtype=torch.float64), dim=0
    )
    middle = means.clamp(ends[0], ends[1])
    centred = middle - middle.mean(0)
    axes = torch.linalg.eigh(centred.T @ centred).eigenvectors.flip(1)
    axes = axes * axes.gather(0, axes.abs().argmax(0, keepdim=True)).sign()
    across, down, depth = ((means - middle.mean(0)) @ axes).unbind(1)
    return across, down, depth


def _fitted(across: Tensor, down: Tensor, width: int, height: int) -> tuple[Tensor, Tensor]:
    """Return pixels of plane positions, such that most of them fill the picture, with equal scale along both axes."""
    ends = torch.tensor(_MIDDLE, dtype=torch.float64)
    step = max(1, len(across) // 100_000)
    (left, right), (top, bottom) = (
        torch.quantile(values[::step], ends).tolist() for values in (across, down)
    )
    scale = 0.85 / (max((right - left) / width, (bottom - top) / height) or 1.0)
    x = (across - (left + right) / 2) * scale + width / 2
    y = (down - (top + bottom) / 2) * scale + height / 2
    return x.clamp(-1e6, 1e6).long(), y.clamp(-1e6, 1e6).long()
