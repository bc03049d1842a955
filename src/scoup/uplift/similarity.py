"""Similarity of small renders of a splat and photographs.

Both are reduced to detail of middle size (``detail``), and correlated over the pixels to which Gaussians contribute.
Exposure, white balance and a background that the splat lacks do not matter.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from scoup import raster
from scoup.base import ScoupError
from scoup.io import load_image
from scoup.scene import SH_C0, Camera

Array = NDArray[np.float64]

MOST_VIEWS = 8  # rendered
LONGEST_SIDE = 256  # of a render, in pixels
FINEST, COARSEST = 1.5, 10.0  # standard deviations of the blurs whose difference is detail, in pixels
LEAST_COVERED = 0.002  # mean alpha below which a render is not compared
LEAST_CONTRAST = 4 / 255  # standard deviation below which detail is not scaled up to that of other places
LEAST_DETAIL = 0.1  # mean square of detail that is compared; strong detail is about 1
PLAIN = 0.002  # mean square of detail below which a photograph shows nothing


def sample_views(cameras: Sequence[Camera]) -> list[Camera]:
    """Return at most ``MOST_VIEWS`` cameras: pairs of neighbours, evenly spread, to detect names that are one off."""
    if len(cameras) <= MOST_VIEWS:
        return list(cameras)
    starts = np.linspace(0, len(cameras) - 2, MOST_VIEWS // 2).round().astype(int)
    return [cameras[position] for start in starts for position in (start, start + 1)]


def small_views(cameras: Sequence[Camera]) -> list[Camera]:
    """Resize cameras to one size, because renders are also compared with the photographs of other views."""
    first = cameras[0]
    scale = min(1.0, LONGEST_SIDE / max(first.width, first.height))
    width, height = (max(1, round(side * scale)) for side in (first.width, first.height))
    return [camera.resized(width, height) for camera in cameras]


def render_small(
    prepared: raster.PreparedGaussians, views: Sequence[Camera], raster_preset: str
) -> tuple[Array, Array]:
    """Return renders [V, H, W, 3] of the constant part of the colours over black, and their alphas [V, H, W]."""
    colors = (SH_C0 * prepared.gaussians.sh[:, 0] + 0.5).clamp(min=0)
    images, alphas = [], []
    for camera in views:
        image, alpha = raster.render_channels(raster.project(prepared, camera, raster_preset), colors)
        images.append(image.cpu().double().numpy())
        alphas.append(alpha.cpu().double().numpy())
    return np.stack(images), np.stack(alphas)


def load_photographs(views: Sequence[Camera]) -> Array:
    """Return [V, H, W, 3] in 0..1, of views of one size; NaN for photographs that cannot be read."""
    return np.stack([_photograph(camera) for camera in views])


def _photograph(camera: Camera) -> Array:
    try:
        return load_image(camera).double().numpy() / 255
    except ScoupError:
        return np.full((camera.height, camera.width, 3), np.nan)


def similarities(images: Array, alphas: Array, photographs: Array) -> Array:
    """Return [V, V] correlations of the detail of each render [V, H, W, 3] over black with that of each photograph (all
    NaN if missing), both 0..1, weighted by ``alphas`` [V, H, W].

    They are NaN if a render covers too little, either has hardly any detail, or there is no photograph.
    """
    count = len(images)
    missing: NDArray[np.bool_] = np.isnan(photographs[:, 0, 0, 0])
    if missing.all():
        return np.full((count, count), np.nan)
    filled = np.where(missing[:, None, None, None], 0.0, photographs)
    empty = filled[~missing][alphas[~missing] < 0.1]
    background = np.median(empty, axis=0) if len(empty) else np.zeros(3)
    seen = detail(images + (1 - alphas[..., None]) * background)
    taken = detail(filled)
    # [V, pixels, 3] and [V, pixels]; each pair of views is a product of matrices.
    seen, taken = (maps.reshape(count, -1, 3) for maps in (seen, taken))
    mass = alphas.mean((1, 2))
    weights = alphas.reshape(count, -1)
    weights = weights / np.maximum(weights.sum(1, keepdims=True), 1e-12)
    weighted = weights[..., None] * seen
    mean_seen = weighted.sum(1)  # [V, 3]
    mean_taken = np.einsum("ip,jpc->ijc", weights, taken, optimize=True)
    shared = np.einsum("ipc,jpc->ij", weighted, taken, optimize=True) - np.einsum(
        "ic,ijc->ij", mean_seen, mean_taken
    )
    power_seen = (weighted * seen).sum((1, 2)) - (mean_seen**2).sum(1)
    power_taken = np.einsum("ip,jp->ij", weights, (taken**2).sum(2), optimize=True) - (mean_taken**2).sum(2)
    least = 3 * LEAST_DETAIL
    # A photograph that is plain only where the Gaussians are is unlike the render.
    usable = (mass >= LEAST_COVERED) & (power_seen >= least)
    telling = ~missing & ((taken**2).sum(2).mean(1) >= 3 * PLAIN)
    usable = usable[:, None] & telling[None, :]
    scale = np.sqrt(np.maximum(power_seen[:, None], least) * np.maximum(power_taken, least))
    return np.where(usable, shared / scale, np.nan)


def detail(images: Array) -> Array:
    """Return structure of middle size in images [V, H, W, 3], without brightness, about equally strong everywhere, so
    that no single edge dominates."""
    from scipy import ndimage

    scale = max(images.shape[1:3]) / LONGEST_SIDE

    def blurred(maps: Array, sigma: float) -> Array:
        return ndimage.gaussian_filter(maps, (0, sigma * scale, sigma * scale, 0), mode="nearest")

    fine = blurred(images, FINEST)
    details = fine - blurred(fine, COARSEST)
    power = blurred((details**2).mean(3, keepdims=True), COARSEST)
    return details / np.sqrt(power + LEAST_CONTRAST**2)
