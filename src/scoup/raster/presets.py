"""Constants on which rasterisers of this field disagree, as named presets (docs/conventions.md)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from scoup.base import InputError, UnknownNameError

ALPHA_MIN = 1.0 / 255.0  # a Gaussian contributes exactly to the pixels where its alpha reaches this
LOW_PASS = 0.3  # added to the diagonal of the 2D covariance, in square pixels


@dataclass(frozen=True)
class RasterPreset:
    """Constants of the rasteriser with which a scene was trained."""

    name: str
    """Of the preset."""
    near: float
    """Gaussians at this view depth or nearer are not drawn (world units)."""
    alpha_max: float
    """Upper bound of a Gaussian's alpha at a pixel."""
    stop: float
    """A pixel is finished before the Gaussian that would bring its transmittance below this."""
    stop_inclusive: bool
    """Whether a transmittance equal to ``stop`` finishes the pixel too."""
    centred_clamp: bool
    """Clamp the Jacobian at 1.3 tan(fov / 2) about the image centre (Inria); otherwise at 0.3 tan(fov / 2) beyond the
    image border, wherever the principal point lies (gsplat)."""


RASTER_PRESETS = {
    "inria": RasterPreset("inria", 0.2, 0.99, 1e-4, stop_inclusive=False, centred_clamp=True),
    "gsplat": RasterPreset("gsplat", 0.01, 0.99, 1e-4, stop_inclusive=True, centred_clamp=False),
}


def raster_preset(preset: str | RasterPreset) -> RasterPreset:
    """Return the preset of that name, or of name and near plane, such as "inria:0.0125"; a preset passes through."""
    if isinstance(preset, RasterPreset):
        return preset
    name, colon, plane = preset.partition(":")
    if name not in RASTER_PRESETS:
        raise UnknownNameError("raster preset", preset, RASTER_PRESETS)
    if not colon:
        return RASTER_PRESETS[name]
    try:
        near = float(plane)
    except ValueError:
        near = math.nan
    if not 0 <= near < math.inf:
        raise InputError(f"raster preset {preset!r}: the near plane after the colon must be a number from 0")
    return replace(RASTER_PRESETS[name], name=preset, near=near)
