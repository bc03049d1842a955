"""Whether a splat and cameras fit: how much the cameras see of it, and whether that is what is on their photographs.

Some views are rendered small. A render is compared with its own photograph and with those of the other views
(``scoup.uplift.similarity``).
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from scoup.base.counts import listed, share_of, verb
from scoup.base.errors import InputError, ScoupWarning
from scoup.scene.cameras import Camera
from scoup.scene.gaussians import Gaussians
from scoup.uplift.similarity import Array, photographs_of, renders_of, similarities, small_views

MOST_VIEWS = 8  # rendered
BLIND = 0.0004  # share of painted pixels below which a camera sees nothing
LIKE = 0.3  # correlation from which a render looks like a photograph
UNLIKE = 0.15  # median correlation below which the renders look like none
BETTER = 0.1  # by which one correlation exceeds another clearly
FEW = 0.25  # share of the views that may be wrong in a scene that fits
MOST = 0.75  # share of blind views from which a scene is hopeless
FEW_CODED = 0.01  # share of coded Gaussians below which a build is doubted
ENOUGH = 4  # views, compared or blind, from which photographs may make a scene hopeless

OVERRIDE = "to go on all the same, give --no-check-fit (check_fit=False in Python)"
_SAME_SCENE = (
    "name splat and folder of one scene, in the same frame (trainers often normalise the world; for nerfstudio's there "
    "is --dataparser-transforms)"
)
_SAME_NAMES = "check that each photograph has the name of its own camera"
_FOCAL = "check the focal lengths"


class Verdict(Enum):
    """What is made of the measurements of a ``Fit``."""

    FITS = "fits"
    DOUBTFUL = "doubtful"
    HOPELESS = "hopeless"


@dataclass(frozen=True, eq=False)
class Fit:
    """What some cameras see of a splat, and how that compares with their photographs.

    Attributes:
        names: [V] of the views.
        coverage: [V] share of the pixels with an alpha above one half.
        similarity: [V, V] correlation of each view's render with each view's photograph, -1..1; NaN where one has
            nothing to compare, or there is no photograph.
    """

    names: tuple[str, ...]
    coverage: Array
    similarity: Array

    @property
    def blind(self) -> NDArray[np.bool_]:
        """[V] whether a camera sees nothing."""
        return self.coverage < BLIND

    @property
    def own(self) -> Array:
        """[V] correlation of each render with its own photograph."""
        return np.diagonal(self.similarity)

    @property
    def others(self) -> Array:
        """[V, V] ``similarity``, NaN for each view's own photograph."""
        return np.where(np.eye(len(self.names), dtype=bool), np.nan, self.similarity)

    @property
    def compared(self) -> NDArray[np.bool_]:
        """[V] whether a view's render was compared with its photograph."""
        return ~np.isnan(self.own)

    @property
    def mistaken(self) -> list[tuple[str, str]]:
        """Views whose render looks clearly more like the photograph of another view, and that one."""
        others = np.nan_to_num(self.others, nan=-1.0)
        best = others.argmax(1)
        found = others.max(1, initial=-1.0)
        wrong = self.compared & (found >= LIKE) & (found > self.own + BETTER)
        return [(self.names[view], self.names[best[view]]) for view in np.flatnonzero(wrong)]

    @property
    def unlike(self) -> list[str]:
        """Views whose render does not look like their own photograph, or looks more like another."""
        mistaken = dict(self.mistaken)
        low = self.compared & (np.nan_to_num(self.own, nan=1.0) < LIKE)
        return [name for name, is_low in zip(self.names, low, strict=True) if is_low or name in mistaken]

    @property
    def verdict(self) -> Verdict:
        """From a share of ``MOST`` blind views a scene is hopeless, of however few: they show nothing to build from.
        Below it, the views that are compared with photographs decide; blind ones only where none is compared.
        """
        if len(self.names) and self.blind.mean() >= MOST:
            return Verdict.HOPELESS
        compared = int(self.compared.sum())
        if not compared:
            return Verdict.DOUBTFUL if self.blind.sum() > FEW * len(self.names) else Verdict.FITS
        if len(self.unlike) <= FEW * compared:
            return Verdict.FITS
        own = np.where(self.blind, 0.0, self.own)  # what sees nothing looks like nothing
        own = own[~np.isnan(own)]
        gain = np.median(own) - (0.0 if np.isnan(self.others).all() else np.nanmedian(self.others))
        hopeless = len(own) >= ENOUGH and np.median(own) < UNLIKE and gain < BETTER
        return Verdict.HOPELESS if hopeless else Verdict.DOUBTFUL

    def describe(self) -> dict[str, Any]:
        """The verdict, the views tried, and the medians of what was measured, as plain values for people and JSON."""
        compared = self.compared.any()
        return {
            "verdict": self.verdict.value,
            "views_tried": len(self.names),
            "coverage": round(float(np.median(self.coverage)), 3) if self.names else None,
            "similarity": round(float(np.median(self.own[self.compared])), 3) if compared else None,
        }

    def reason(self) -> str:
        """What was measured where the verdict is not that they fit."""
        blind = [name for name, is_blind in zip(self.names, self.blind, strict=True) if is_blind]
        unlike = self.unlike
        said = []
        if blind:
            some = share_of(len(blind), len(self.names), "camera tried", "cameras tried")
            said.append(f"{some} {verb(len(blind), 'sees', 'see')} nothing of the splat ({listed(blind)})")
        if unlike:
            own = float(np.median(self.own[self.compared]))
            some = share_of(len(unlike), int(self.compared.sum()), "render tried", "renders tried")
            differ = verb(len(unlike), "looks unlike its photograph", "look unlike their photographs")
            said.append(f"{some} {differ} ({listed(unlike)}; median correlation {own:.2f})")
        if self.mistaken:
            said.append("the camera of {} sees what is on {}".format(*self.mistaken[0]))
        return ", ".join(said)

    def remedies(self) -> str:
        """What to try where the verdict is not that they fit."""
        names = [_SAME_NAMES] if self.mistaken else []
        return "; ".join([*names, _SAME_SCENE, *([_FOCAL] if self.unlike else [])])


def check_fit(
    gaussians: Gaussians,
    cameras: Sequence[Camera],
    raster_preset: str = "inria",
    backend: str | None = None,
    splat: str | Path | None = None,
) -> None:
    """Refuse cameras that do not fit the splat.

    Args:
        gaussians, cameras, raster_preset, backend: see ``measure_fit``.
        splat: the file of the Gaussians, for messages.

    Raises:
        InputError: the cameras see nothing, or nothing of what is on their photographs.

    Warns:
        ScoupWarning: the fit is doubtful.
    """
    fit = measure_fit(gaussians, cameras, raster_preset, backend)
    where = "the splat " if splat is None else f"{splat}: "
    if fit.verdict is Verdict.HOPELESS:
        said = f"{where}does not fit the cameras: {fit.reason()}; {fit.remedies()}; {OVERRIDE}"
        raise InputError(said)
    if fit.verdict is Verdict.DOUBTFUL:
        message = f"{where}may not fit the cameras: {fit.reason()}; {fit.remedies()}"
        warnings.warn(message, ScoupWarning, stacklevel=3)


def measure_fit(
    gaussians: Gaussians, cameras: Sequence[Camera], raster_preset: str = "inria", backend: str | None = None
) -> Fit:
    """Render some of the cameras small and compare the renders with the photographs there are.

    Args:
        gaussians: the trained scene.
        cameras: some are tried (``views_tried``). Photographs that are missing or cannot be read are passed over.
        raster_preset, backend: see ``raster.project``.
    """
    views = views_tried(cameras)
    if not views:
        return Fit((), np.zeros(0), np.zeros((0, 0)))
    views = small_views(views)
    images, alphas = renders_of(gaussians, views, raster_preset, backend)
    return Fit(
        tuple(camera.name for camera in views),
        (alphas > 0.5).mean((1, 2)),
        similarities(images, alphas, photographs_of(views)),
    )


def views_tried(cameras: Sequence[Camera]) -> list[Camera]:
    """At most ``MOST_VIEWS`` of the cameras: pairs of neighbours, evenly spread, so that photographs whose names are
    one off meet the camera they belong to.
    """
    if len(cameras) <= MOST_VIEWS:
        return list(cameras)
    starts = np.linspace(0, len(cameras) - 2, MOST_VIEWS // 2).round().astype(int)
    return [cameras[position] for start in starts for position in (start, start + 1)]


def check_coded(weights: Tensor) -> None:
    """Refuse codes of a scene of which the views with regions show nothing.

    Args:
        weights: [N, S, K] of the Gaussians' codes.

    Raises:
        InputError: no Gaussian has a code.

    Warns:
        ScoupWarning: hardly any has.
    """
    share = float((weights[..., 0] > 0).any(1).float().mean()) if len(weights) else 0.0
    if share == 0:
        raise InputError(f"the cameras see nothing: no Gaussian paints a region in any view; {_SAME_SCENE}")
    if share < FEW_CODED:
        message = f"only {share:.2%} of the Gaussians paint a region; {_SAME_SCENE}"
        warnings.warn(message, ScoupWarning, stacklevel=3)
