"""Check that a splat and cameras fit: what the cameras see of it, and whether their photographs show the same.

Some views are rendered small. Each render is compared with its own photograph and with those of the other views
(``scoup.uplift.similarity``).
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from scoup import raster
from scoup.base import InputError, ScoupWarning, listed, share_of
from scoup.scene import Camera, Gaussians
from scoup.uplift.near_plane import scene_preset
from scoup.uplift.similarity import (
    LEAST_COVERED,
    Array,
    load_photographs,
    render_small,
    sample_views,
    similarities,
    small_views,
)

BLIND = 0.0004  # share of covered pixels below which a camera sees nothing
# Tuned on kitchen, desk and table of the real data: the medians of right scenes are 0.51 (of 5 % of the Gaussians) and
# more, of wrong ones 0.37 (focal lengths of 110 %) and less. Held out: 0.47 and 0.39 on shelves, hall and yard.
LIKE = 0.4  # correlation from which a render looks like a photograph; below this median a scene is hopeless
SURE = 0.8  # median correlation from which no other explanation is tried
BETTER = 0.1  # difference from which one correlation is clearly higher
FEW = 0.25  # share of the views that may be wrong in a scene that fits
MOST = 0.75  # share of blind views from which a scene is hopeless
FEW_CODED = 0.01  # share of coded Gaussians below which a build is doubtful
ENOUGH = 4  # views, compared or blind, from which photographs may make a scene hopeless

OVERRIDE = "to continue anyway, pass `check_fit=False`"
_SAME_SCENE = (
    "use splat and folder of one scene, in the same frame (trainers often normalise the world; for "
    "nerfstudio's pass `dataparser_transforms`)"
)
_SAME_NAMES = "check that each photograph has the name of its own camera"
_FOCAL = "check the focal lengths"
FOCAL_LENGTHS = (0.9, 0.95, 1.05, 1.1)  # tried in place of the cameras' own, which are 1


class Verdict(Enum):
    """The conclusion from a ``Fit``."""

    FITS = "fits"
    NOT_JUDGED = "not judged"
    DOUBTFUL = "doubtful"
    HOPELESS = "hopeless"


@dataclass(frozen=True, eq=False)
class Fit:
    """Views of a splat by some cameras, compared with their photographs."""

    names: tuple[str, ...]  # of the V views
    coverage: Array  # [V] share of the pixels with an alpha above one half
    similarity: Array  # [V, V] correlation of each render with each photograph, -1..1; NaN if not comparable
    matches: str = ""  # the change of splat or cameras with which the renders are clearly more similar
    raster_preset: str = "inria"  # of the renders

    @property
    def blind(self) -> NDArray[np.bool_]:
        """[V], whether a camera sees nothing."""
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
        """Views whose render is clearly more similar to the photograph of another view, and that view."""
        others = np.nan_to_num(self.others, nan=-1.0)
        best = others.argmax(1)
        highest = others.max(1, initial=-1.0)
        wrong = self.compared & (highest >= LIKE) & (highest > self.own + BETTER)
        return [(self.names[view], self.names[best[view]]) for view in np.flatnonzero(wrong)]

    @property
    def unlike(self) -> list[str]:
        """Views whose render is unlike their photograph, or more similar to another."""
        mistaken = dict(self.mistaken)
        low = self.compared & (np.nan_to_num(self.own, nan=1.0) < LIKE)
        return [name for name, is_low in zip(self.names, low, strict=True) if is_low or name in mistaken]

    @property
    def verdict(self) -> Verdict:
        """Return the verdict. From a share of ``MOST`` blind views a scene is hopeless: they show nothing to build
        from.

        Below it, the views that are compared with photographs decide; blind ones only if none is compared.
        """
        if len(self.names) and self.blind.mean() >= MOST:
            return Verdict.HOPELESS
        compared = int(self.compared.sum())
        if not compared:
            return Verdict.DOUBTFUL if self.blind.sum() > FEW * len(self.names) else Verdict.NOT_JUDGED
        few = FEW * compared
        if len(self.unlike) <= few and not self.matches:
            return Verdict.FITS
        values = np.where(self.coverage < LEAST_COVERED, 0.0, self.own)  # hardly covered: unlike
        values = values[~np.isnan(values)]
        is_wrong = np.median(values) < LIKE or len(self.mistaken) > few or self.matches
        return Verdict.HOPELESS if is_wrong and len(values) >= ENOUGH else Verdict.DOUBTFUL

    @property
    def is_hopeless(self) -> bool:
        return self.verdict is Verdict.HOPELESS

    def describe(self) -> dict[str, Any]:
        """Return verdict, number of views tried, and medians of the measurements as JSON values."""
        compared = self.compared.any()
        preset = {"raster_preset": self.raster_preset} if ":" in self.raster_preset else {}
        return {
            "verdict": self.verdict.value,
            "views_tried": len(self.names),
            "coverage": round(float(np.median(self.coverage)), 3) if self.names else None,
            "similarity": round(float(np.median(self.own[self.compared])), 3) if compared else None,
            **preset,
        }

    def reason(self) -> str:
        """Return the reason for a verdict other than a fit."""
        blind = [name for name, is_blind in zip(self.names, self.blind, strict=True) if is_blind]
        unlike = self.unlike
        said = []
        if blind:
            some = share_of(len(blind), len(self.names), "camera tried", "cameras tried")
            said.append(
                f"{some} {'sees' if len(blind) == 1 else 'see'} nothing of the splat ({listed(blind)})"
            )
        if unlike:
            median = float(np.median(self.own[self.compared]))
            some = share_of(len(unlike), int(self.compared.sum()), "render tried", "renders tried")
            one = len(unlike) == 1
            differ = "looks unlike its photograph" if one else "look unlike their photographs"
            said.append(f"{some} {differ} ({listed(unlike)}; median correlation {median:.2f})")
        if self.matches:
            said.append(f"the photographs match {self.matches}")
        if self.mistaken:
            said.append("the camera of {} sees what is on {}".format(*self.mistaken[0]))
        return ", ".join(said)

    def remedies(self) -> str:
        """Return remedies for a verdict other than a fit."""
        names = [_SAME_NAMES] if self.mistaken else []
        return "; ".join([*names, _SAME_SCENE, *([_FOCAL] if self.unlike or self.matches else [])])

    def problem(self, cameras: Sequence[Camera], splat: str | Path | None = None) -> str:
        """Return the problem with the cameras, or that it was not judged, with remedies; "" for a good fit.

        ``splat`` is the file of the Gaussians, for messages.
        """
        where = "the splat " if splat is None else f"{splat}: "
        verdicts = {
            Verdict.HOPELESS: "does not fit the cameras: ",
            Verdict.DOUBTFUL: "may not fit the cameras: ",
        }
        if said := verdicts.get(self.verdict):
            return f"{where}{said}{self.reason()}; {self.remedies()}"
        if self.verdict is Verdict.NOT_JUDGED and any(camera.image_path for camera in cameras):
            return (
                f"{where}whether the cameras fit was not judged: no render tried can be compared with its photograph "
                "(unreadable, or without detail); check the photographs"
            )
        return ""


def check_fit(
    gaussians: Gaussians,
    cameras: Sequence[Camera],
    raster_preset: str = "inria",
    backend: str | None = None,
    splat: str | Path | None = None,
    prepared: raster.PreparedGaussians | None = None,
) -> None:
    """Raise an InputError for cameras that do not fit the splat, and warn of a doubtful fit, or of photographs with
    which no render can be compared.

    ``raster_preset`` has the near plane of the scene (``scene_preset``); ``splat`` is the file of the Gaussians, for
    messages; ``prepared`` are the same Gaussians, if they are prepared already.
    """
    prepared = prepared or raster.prepare_gaussians(gaussians, backend)
    fit = _measured(gaussians, cameras, raster_preset, backend, prepared)
    problem = fit.problem(cameras, splat)
    if fit.is_hopeless:
        raise InputError(f"{problem}; {OVERRIDE}")
    if problem:
        warnings.warn(problem, ScoupWarning, stacklevel=3)


def measure_fit(gaussians: Gaussians, cameras: Sequence[Camera], raster_preset: str = "inria") -> Fit:
    """Render some of the cameras small, and compare the renders with those photographs that can be read; the near plane
    is that of the scene."""
    prepared = raster.prepare_gaussians(gaussians)
    preset = scene_preset(gaussians, cameras, raster_preset, prepared=prepared)
    return _measured(gaussians, cameras, preset, None, prepared)


def _measured(
    gaussians: Gaussians,
    cameras: Sequence[Camera],
    raster_preset: str,
    backend: str | None,
    prepared: raster.PreparedGaussians,
) -> Fit:
    """Return the fit by renders with this near plane."""
    views = sample_views(cameras)
    if not views:
        return Fit((), np.zeros(0), np.zeros((0, 0)))
    views = small_views(views)
    photographs = load_photographs(views)

    def compared(prepared: raster.PreparedGaussians, views: Sequence[Camera]) -> tuple[Array, Array]:
        images, alphas = render_small(prepared, views, raster_preset)
        return (alphas > 0.5).mean((1, 2)), similarities(images, alphas, photographs)

    coverage, similarity = compared(prepared, views)
    fit = Fit(tuple(camera.name for camera in views), coverage, similarity, raster_preset=raster_preset)
    if not fit.compared.any() or np.median(fit.own[fit.compared]) >= SURE:
        return fit
    gains = {}
    for change, splat, cameras in _changes(gaussians, views):
        changed = prepared if splat is gaussians else raster.prepare_gaussians(splat, backend)
        gain = np.diagonal(compared(changed, cameras)[1]) - fit.own
        gains[change] = float(np.median(np.nan_to_num(gain)))
    best = max(gains, key=gains.__getitem__)
    return replace(fit, matches=best) if gains[best] > BETTER else fit


def _changes(
    gaussians: Gaussians, views: Sequence[Camera]
) -> Iterator[tuple[str, Gaussians, Sequence[Camera]]]:
    """Alternative explanations: other focal lengths, or a mirrored splat."""
    for factor in FOCAL_LENGTHS:
        scale = views[0].K.new_tensor([[factor, 1, 1], [1, factor, 1], [1, 1, 1]])
        changed = [replace(view, K=view.K * scale) for view in views]
        yield f"focal lengths of {factor:.0%}", gaussians, changed
    for axis, name in enumerate("xyz"):
        signs = gaussians.means.new_ones(3)
        signs[axis] = -1
        quats = torch.cat([gaussians.quats[:, :1], -signs * gaussians.quats[:, 1:]], 1)
        mirrored = replace(gaussians, means=signs * gaussians.means, quats=quats)
        yield f"the splat with {name} negated", mirrored, views


def check_coded(weights: Tensor) -> None:
    """Raise an InputError if no Gaussian has a code (``weights`` [N, S, K]), and warn if hardly any has."""
    share = float((weights[..., 0] > 0).any(1).float().mean()) if len(weights) else 0.0
    if share == 0:
        raise InputError(
            f"the cameras see nothing: no Gaussian contributes to a region of any view; {_SAME_SCENE}"
        )
    if share < FEW_CODED:
        message = f"only {share:.2%} of the Gaussians contribute to a region; {_SAME_SCENE}"
        warnings.warn(message, ScoupWarning, stacklevel=3)
