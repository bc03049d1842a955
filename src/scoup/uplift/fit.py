"""Whether a splat and cameras fit: how much the cameras see of it, and whether that is what is on their photographs.

Some views are rendered small. A render is compared with its own photograph and with those of the other views: both are
reduced to the detail of middle size (``detail``), and correlated over the pixels that the Gaussians paint. Neither
exposure, white balance nor a background that the splat lacks plays a part. ``benchmarks/fit.py`` measures how often the
verdict is right; docs/benchmarks.md has the figures.
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
from scipy import ndimage
from torch import Tensor

from scoup import raster
from scoup.base.errors import InputError, ScoupError, ScoupWarning
from scoup.base.processes import ALONE, Processes
from scoup.io.images import load_image
from scoup.raster.spherical_harmonics import C0
from scoup.scene.cameras import Camera
from scoup.scene.gaussians import Gaussians

Array = NDArray[np.float64]

MOST_VIEWS = 8  # rendered
LONGEST_SIDE = 256  # of a render, in pixels
FINEST, COARSEST = 1.5, 10.0  # standard deviations between which detail lies, in pixels of the longest side
BLIND = 0.0004  # share of painted pixels below which a camera sees nothing
LEAST_PAINTED = 0.002  # mean alpha below which a render is not compared with photographs
LEAST_CONTRAST = 4 / 255  # standard deviation of detail below which it stays weaker than that of other places
LEAST_DETAIL = 0.1  # mean square of the detail that is compared; where detail is strong, it is about 1
PLAIN = 0.002  # mean square of the detail below which a whole photograph shows nothing
LIKE = 0.3  # correlation from which a render looks like a photograph
UNLIKE = 0.15  # median correlation below which the renders look like none
BETTER = 0.1  # by which one correlation exceeds another clearly
FEW = 0.25  # share of the views that may be wrong in a scene that fits
MOST = 0.75  # share of blind views from which a scene is hopeless
FEW_CODED = 0.01  # share of coded Gaussians below which a build is doubted
ENOUGH = 4  # views, compared or blind, from which a scene may be called hopeless

OVERRIDE = "to go on all the same, give scoup build or update --no-check-fit (check_fit=False in Python)"
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
        """Right, doubtful or hopeless; where views are compared with photographs, these decide over blind ones."""
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
            said.append(
                f"{len(blind)} of {len(self.names)} cameras tried see nothing of the splat ({_listed(blind)})"
            )
        if unlike:
            own = float(np.median(self.own[self.compared]))
            said.append(
                f"{len(unlike)} of {int(self.compared.sum())} renders tried look unlike their photographs "
                f"({_listed(unlike)}; median correlation {own:.2f})"
            )
        if self.mistaken:
            said.append("the camera of {} sees what is on {}".format(*self.mistaken[0]))
        return ", ".join(said)

    def remedies(self) -> str:
        """What to try where the verdict is not that they fit."""
        names = [_SAME_NAMES] if self.mistaken else []
        return "; ".join([*names, _SAME_SCENE, *([_FOCAL] if self.unlike else [])])


def refuse_misfit(
    gaussians: Gaussians,
    cameras: Sequence[Camera],
    raster_preset: str = "inria",
    backend: str | None = None,
    splat: str | Path | None = None,
    processes: Processes = ALONE,
) -> None:
    """Refuse cameras that do not fit the splat; one process measures, and all of them end alike.

    Args:
        gaussians, cameras, raster_preset, backend: see ``measure_fit``.
        splat: the file of the Gaussians, for messages.

    Raises:
        InputError: the cameras see nothing, or nothing of what is on their photographs.

    Warns:
        ScoupWarning: the fit is doubtful.
    """
    mine = measure_fit(gaussians, cameras, raster_preset, backend) if processes.first else None
    fit = processes.from_rank(mine, 0)
    where = "the splat " if splat is None else f"{splat}: "
    if fit.verdict is Verdict.HOPELESS:
        said = f"{where}does not fit the cameras: {fit.reason()}; {fit.remedies()}; {OVERRIDE}"
        raise InputError(said)
    if fit.verdict is Verdict.DOUBTFUL and processes.first:
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
    scale = min(1.0, LONGEST_SIDE / max(views[0].width, views[0].height))
    width, height = (max(1, round(side * scale)) for side in (views[0].width, views[0].height))
    # One size for all, whatever their shapes: renders are compared with the photographs of other views, too.
    views = [camera.resized(width, height) for camera in views]
    images, alphas = _renders(gaussians, views, raster_preset, backend)
    photographs = np.stack([_photograph(camera) for camera in views])
    return Fit(
        tuple(camera.name for camera in views),
        (alphas > 0.5).mean((1, 2)),
        similarities(images, alphas, photographs),
    )


def views_tried(cameras: Sequence[Camera]) -> list[Camera]:
    """At most ``MOST_VIEWS`` of the cameras: pairs of neighbours, evenly spread, so that photographs whose names are
    one off meet the camera they belong to.
    """
    if len(cameras) <= MOST_VIEWS:
        return list(cameras)
    starts = np.linspace(0, len(cameras) - 2, MOST_VIEWS // 2).round().astype(int)
    return [cameras[position] for start in starts for position in (start, start + 1)]


def similarities(images: Array, alphas: Array, photographs: Array) -> Array:
    """[V, V] correlation of the detail of each render with that of each photograph, over the pixels painted.

    Args:
        images: [V, H, W, 3] renders over black, 0..1.
        alphas: [V, H, W] of them; the weights of the pixels.
        photographs: [V, H, W, 3], 0..1; all NaN where there is none.

    Returns:
        Correlations; NaN where a render paints too little, either has hardly any detail, or there is no photograph.
    """
    count = len(images)
    missing: NDArray[np.bool_] = np.isnan(photographs[:, 0, 0, 0])
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
    # A photograph that is plain where the Gaussians paint, but not elsewhere, is unlike the render.
    usable = (mass >= LEAST_PAINTED) & (power_seen >= least)
    telling = ~missing & ((taken**2).sum(2).mean(1) >= 3 * PLAIN)
    usable = usable[:, None] & telling[None, :]
    scale = np.sqrt(np.maximum(power_seen[:, None], least) * np.maximum(power_taken, least))
    return np.where(usable, shared / scale, np.nan)


def detail(images: Array) -> Array:
    """Structure of middle size in images [V, H, W, 3], about equally strong everywhere: no brightness, and nothing that
    one strong edge could outweigh.
    """
    scale = max(images.shape[1:3]) / LONGEST_SIDE

    def blurred(maps: Array, sigma: float) -> Array:
        return ndimage.gaussian_filter(maps, (0, sigma * scale, sigma * scale, 0), mode="nearest")

    fine = blurred(images, FINEST)
    found = fine - blurred(fine, COARSEST)
    power = blurred((found**2).mean(3, keepdims=True), COARSEST)
    return found / np.sqrt(power + LEAST_CONTRAST**2)


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


def _renders(
    gaussians: Gaussians, views: Sequence[Camera], raster_preset: str, backend: str | None
) -> tuple[Array, Array]:
    """Renders [V, H, W, 3] over black in the constant part of the colours, and their alphas [V, H, W]."""
    prepared = raster.prepare_gaussians(gaussians, backend)
    colors = (C0 * prepared.gaussians.sh[:, 0] + 0.5).clamp(min=0)
    images, alphas = [], []
    for camera in views:
        image, alpha = raster.render_channels(raster.project(prepared, camera, raster_preset), colors)
        images.append(image.cpu().double().numpy())
        alphas.append(alpha.cpu().double().numpy())
    return np.stack(images), np.stack(alphas)


def _photograph(camera: Camera) -> Array:
    """[H, W, 3] in 0..1; NaN if there is none that can be read."""
    try:
        return load_image(camera).double().numpy() / 255
    except ScoupError:
        return np.full((camera.height, camera.width, 3), np.nan)


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:3]) + (", ..." if len(names) > 3 else "")
