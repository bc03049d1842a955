"""The share of a scene that masks of its photographs hide, and whether they may be the other way round."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scoup.base import InputError, ScoupError, counted, spread
from scoup.extract.photograph_choice import posed_scene
from scoup.extract.photographs import LOSSY, Photograph, read_photograph

_MOST_HIDDEN = 0.5  # of the pixels, or of the scene in them, by masks that may be the other way round
_MOST_READ = 24  # masks that tell the shares
_MIDDLE = 1 / 3 + np.indices((9, 9)).reshape(2, -1).T / 27  # [81, 2] shares of width and height


def report_masks(
    photographs: Sequence[Photograph],
    scene: Path | None = None,
    gaussians: Path | None = None,
    images: Path | None = None,
) -> str:
    """Return how much of the pixels masks and transparency hide, "" for nothing.

    InputError where masks found by their names hide most pixels, or most of the scene: its splat or COLMAP's points
    (arguments as of ``PhotographChoice.choose``), else the middle of the photographs. They may be the other way round.
    """
    masked = [item for item in photographs if item.mask]
    may_be_transparent = [item for item in photographs if item.path.suffix.lower() not in LOSSY]
    sample = spread(masked or may_be_transparent, _MOST_READ)
    guessed = any(item.guessed for item in masked)
    places: dict[Path, NDArray[np.float64]] = {}
    if guessed and scene:
        places = _scene_places(scene, gaussians, images, sample)
    shares = []
    for item in sample:
        with suppress(ScoupError), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            pixels = read_photograph(item.path, 270, item.mask, item.masks_keep)
            hidden = np.zeros((1, 1)) if pixels.masked is None else pixels.as_stored(pixels.masked)
            spots = found if (found := places.get(item.path)) is not None else _MIDDLE
            columns, rows = (spots * hidden.shape[::-1]).astype(int).T
            shares.append((hidden.mean(), hidden[rows, columns].mean()))
    share, of_scene = np.mean(shares, 0) if shares else (0.0, 0.0)
    what = counted(len(masked), "mask") if masked else "transparent photographs"
    if guessed and max(share, of_scene) > _MOST_HIDDEN:
        where = "the splat or points in them" if places else "their middle"
        raise InputError(
            f"{masked[0].mask}: {what} would hide {share:.0%} of the pixels, and {of_scene:.0%} of {where}, where "
            "black; if so, pass `masks='white'`, or `masks='black'` if they mark what to hide in white; `masks=False` "
            "ignores them"
        )
    return f"{what}: {share:.0%} of the pixels get no regions" if share else ""


def _scene_places(
    scene: Path, gaussians: Path | None, images: Path | None, photographs: Sequence[Photograph]
) -> dict[Path, NDArray[np.float64]]:
    """Return where the scene is in photographs, [M, 2] shares of width and height, by their files."""
    with suppress(InputError), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        cameras, surface = posed_scene(scene, photographs, gaussians, images)
        means = surface.means[surface.opacities > 0.1]
        return {
            path: (view.pixels(means[seen])[0] / view.K.new_tensor([view.width, view.height])).numpy()
            for path, view in cameras.items()
            if bool((seen := view.shows(means)).any())
        }
    return {}
