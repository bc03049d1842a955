"""Constants on which rasterisers of this field disagree, as named presets (docs/conventions.md)."""

from __future__ import annotations

from dataclasses import dataclass

from scoup.base.errors import UnknownNameError

ALPHA_MIN = 1.0 / 255.0  # a Gaussian paints exactly the pixels where its alpha reaches this
LOW_PASS = 0.3  # added to the diagonal of the 2D covariance, in square pixels


@dataclass(frozen=True)
class RasterPreset:
    """What a trained scene expects of its rasteriser.

    Attributes:
        name: the preset's name.
        near: Gaussians at this view depth or nearer are not drawn (world units).
        alpha_max: upper bound of a Gaussian's alpha at a pixel.
        stop: a pixel is finished before the Gaussian that would bring its transmittance below this.
        stop_inclusive: whether a transmittance equal to ``stop`` finishes the pixel too.
        centred_clamp: clamp the Jacobian at 1.3 tan(fov / 2) about the image centre (Inria); otherwise at
            0.3 tan(fov / 2) beyond the image border, wherever the principal point lies (gsplat).
    """

    name: str
    near: float
    alpha_max: float
    stop: float
    stop_inclusive: bool
    centred_clamp: bool


RASTER_PRESETS = {
    "inria": RasterPreset("inria", 0.2, 0.99, 1e-4, stop_inclusive=False, centred_clamp=True),
    "gsplat": RasterPreset("gsplat", 0.01, 0.99, 1e-4, stop_inclusive=True, centred_clamp=False),
}


def raster_preset(preset: str | RasterPreset) -> RasterPreset:
    """The preset of that name; a preset passes through.

    Raises:
        UnknownNameError: there is no preset of that name.
    """
    if isinstance(preset, RasterPreset):
        return preset
    if preset not in RASTER_PRESETS:
        raise UnknownNameError("raster preset", preset, RASTER_PRESETS)
    return RASTER_PRESETS[preset]
