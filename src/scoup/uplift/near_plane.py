"""The near plane of a scene: presets name it in world units, which are arbitrary; what cameras and splat say decides.

A trainer whose near plane cut what its cameras see could not have trained it. So the preset's plane is kept unless it
cuts; then a share of the depth of the scene takes its place, if photographs or, without any, the extent of the cut tell
that what is cut belongs to the scene. Floaters in front of a camera do not: the trainer never showed them.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence

import numpy as np
from torch import Tensor

from scoup import raster
from scoup.base import ScoupWarning
from scoup.raster import raster_preset
from scoup.scene import Camera, Gaussians
from scoup.uplift.similarity import (
    Array,
    load_photographs,
    render_small,
    sample_views,
    similarities,
    small_views,
)

SHARE = 0.02  # of the median depth that cameras see: the most that a plane in place of the preset's may be
CUTS = 0.002  # share of a view's pixels that shows what a near plane cuts, from which it cuts
WORSE = 0.02  # by which the correlation of render and photograph may fall with a nearer plane
MOST_CUT = 0.05  # mean share of the views; more than floaters fill, so that a plane that cuts it is wrong
SAMPLE = 100_000  # Gaussians that tell the depth


def scene_preset(
    gaussians: Gaussians,
    cameras: Sequence[Camera],
    preset: str = "inria",
    backend: str | None = None,
    prepared: raster.PreparedGaussians | None = None,
) -> str:
    """Return the name of a raster preset with a near plane that cuts nothing of the scene: the preset itself, or with
    the near plane after a colon, as "inria:0.0125". A preset with a colon is returned as it is. ``prepared`` are the
    same Gaussians, if they are prepared already.

    Warns:
        ScoupWarning: the near plane cuts what cameras see, and no photograph tells whether it belongs to the scene.
    """
    usual, views = raster_preset(preset).near, sample_views(cameras)
    if ":" in preset or not views or not len(gaussians):
        return preset
    depth = _median_depth(gaussians, views)
    if not 0 < SHARE * depth < usual:
        return preset
    # Halves of the preset's: later photographs of the scene, which change the median, do not change the plane.
    nearer = usual / 2.0 ** math.ceil(math.log2(usual / (SHARE * depth)))
    lower = f"{preset}:{nearer:g}"
    if not any(bool(_between(gaussians, view, nearer, usual).any()) for view in views):
        return preset
    small = small_views(views)
    prepared = prepared or raster.prepare_gaussians(gaussians, backend)
    shares = _shares_cut(prepared, small, lower, usual)
    cut = shares >= CUTS
    if not cut.any():
        return preset
    photographs = load_photographs(small)
    if not np.isnan(photographs).all():
        before, after = (
            np.diagonal(similarities(*render_small(prepared, small, name), photographs))[cut]
            for name in (preset, lower)
        )
        gains = (after - np.nan_to_num(before))[~np.isnan(after)]
        if len(gains):
            return preset if np.median(gains) < -WORSE else lower
    if shares.mean() >= MOST_CUT:
        return lower
    warnings.warn(
        f"the near plane ({usual:g} units of the scene) cuts up to {shares.max():.1%} of what a camera sees, "
        f"and no photograph tells whether that belongs to the scene; if it does, pass {lower} as "
        "`raster_preset`",
        ScoupWarning,
        stacklevel=3,
    )
    return preset


def _median_depth(gaussians: Gaussians, views: Sequence[Camera]) -> float:
    """Return the median over views of the median depth of the Gaussians that they show; 0 if they show none."""
    rows = slice(None, None, -(-len(gaussians) // SAMPLE))
    means = gaussians.means[rows][gaussians.opacities[rows] > 0.1].cpu().double()
    depths = [depths[view.shows(means)] for view in views for depths in [view.pixels(means)[1]]]
    medians = [float(some.median()) for some in depths if len(some)]
    return float(np.median(medians)) if medians else 0.0


def _between(gaussians: Gaussians, view: Camera, low: float, high: float) -> Tensor:
    """Return [N] whether Gaussians are drawn at depths above ``low`` and up to ``high``."""
    row = view.viewmat[2].to(gaussians.means)
    depths = gaussians.means @ row[:3] + row[3]
    return (depths > low) & (depths <= high) & (gaussians.opacities >= 1 / 255)


def _shares_cut(
    prepared: raster.PreparedGaussians, views: Sequence[Camera], preset: str, plane: float
) -> Array:
    """Return [V] the share of each render that Gaussians before a plane are."""
    shares = []
    for view in views:
        before = _between(prepared.gaussians, view, 0.0, plane).float()[:, None]
        shares.append(float(raster.render_values(raster.project(prepared, view, preset), before).mean()))
    return np.array(shares)
