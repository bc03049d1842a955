"""The COLMAP model of a scene in whose frame its splat is, where the number of images does not decide."""

from __future__ import annotations

import warnings
from contextlib import suppress
from pathlib import Path

import numpy as np

from scoup.base import InputError, ScoupWarning
from scoup.io import ScenePaths, load_cameras, load_gaussians
from scoup.uplift.fit import BETTER, measure_fit


def fitting_scene(scene: Path, gaussians: Path | None = None, images: Path | None = None) -> Path:
    """Return a scene; where several COLMAP models in it have as many images, the model that fits its splat (or
    ``gaussians``) clearly better, with a ScoupWarning. Readers of the cameras refuse such a scene otherwise."""
    fits: dict[Path, float] = {}
    with suppress(InputError), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        source = ScenePaths(scene).cameras()
        if source.rivals:
            splat = ScenePaths(scene).splat(gaussians)
            loaded = load_gaussians(splat.path)
            for model in (source.path, *source.rivals):
                cameras = list(load_cameras(model, images, distorted="undistort"))
                fit = measure_fit(loaded, cameras, splat.preset)
                fits[model] = float(np.median(fit.own[fit.compared] if fit.compared.any() else fit.coverage))
    best, *others = sorted(fits, key=lambda model: -fits[model]) or [scene]
    if not others or fits[best] - fits[others[0]] <= BETTER:
        return scene
    listed = ", ".join(f"{model} ({fits[model]:.2f})" for model in others)
    said = f"{best}: used, as it fits the splat better (similarity {fits[best]:.2f}) than {listed}"
    warnings.warn(said, ScoupWarning, stacklevel=2)
    return best
