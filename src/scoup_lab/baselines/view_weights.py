"""The blending weights of small views, as sparse matrices: rendering channels is a product with them, its gradient one
with their transpose.

For methods that learn what Gaussians carry by comparing renderings with regions, at every step again (LangSplatV2).
Geometry is frozen, so the weights never change: they are rasterised once and each step only multiplies, which is
cheaper than rasterising again, as those systems do. Times of such methods here are therefore flattering to them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from scipy.sparse import csr_array
from torch import Tensor

from scoup import raster
from scoup.base import InputError
from scoup.uplift import cameras_with_regions
from scoup_lab.baselines.pixel_rules import PixelWeights, pixel_weights

if TYPE_CHECKING:
    from scoup_lab.baselines.rasterised_scene import RasterisedScene


@dataclass(frozen=True, eq=False)
class ViewWeights:
    """Contributions of Gaussians to the pixels of a view."""

    name: str  # of the view
    members: Tensor  # [M] int64, the Gaussians that contribute to any of these pixels
    weights: csr_array  # [P, M] float32 blending weights, of the pixels that have a region at some level
    labels: Tensor  # [S, P] int64, the region of each pixel at each level; -1 for none


def weights_of_views(scene: RasterisedScene, width: int) -> list[ViewWeights]:
    """Return the blending weights of all views with regions, in the order of the cameras.

    ``width``: of the views in pixels, heights in proportion; views that are narrower keep their size.
    """
    if width < 1:
        raise InputError(f"views need a width of one pixel or more, got {width}")
    views = []
    for camera in cameras_with_regions(scene.cameras, scene.regions):
        factor = min(1.0, width / camera.width)
        small = camera.resized(round(camera.width * factor), max(1, round(camera.height * factor)))
        labels = scene.regions.load_labels(camera.name, small.width, small.height)
        pairs = list(pixel_weights(raster.project(scene.gaussians, small, scene.raster_preset)))
        views.append(_view(camera.name, pairs, labels.reshape(len(labels), -1).long()))
    return views


def rendered(view: ViewWeights, channels: Tensor) -> Tensor:
    """Return [P, C] float32: the channels [M, C] of the view's members as its pixels show them; differentiable."""
    return _Rendered.apply(channels, view.weights)


def _view(name: str, pairs: list[PixelWeights], labels: Tensor) -> ViewWeights:
    described = (labels >= 0).any(0).numpy()
    row = np.cumsum(described) - 1  # of each pixel among those kept
    chosen = PixelWeights.joined([band.kept(described[band.pixel]) for band in pairs])
    members, column = np.unique(chosen.gaussian, return_inverse=True)
    entries = (row[chosen.pixel].astype(np.int32), column.astype(np.int32))
    matrix = csr_array((chosen.weight, entries), shape=(int(described.sum()), len(members)))
    return ViewWeights(name, torch.from_numpy(members), matrix, labels[:, torch.from_numpy(described)])


class _Rendered(torch.autograd.Function):
    """A product with a constant sparse matrix; its gradient is one with the transpose."""

    @staticmethod
    def forward(ctx: Any, channels: Tensor, weights: csr_array) -> Tensor:
        ctx.weights = weights
        return torch.from_numpy(weights @ channels.detach().numpy())

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, None]:
        return torch.from_numpy(ctx.weights.T @ gradients[0].numpy()), None
