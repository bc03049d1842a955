"""The photographs of a capture that are worth extracting: sharp ones that show the scene from several directions."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import normalize

from scoup.base import InputError, Progress, ScoupError, no_progress, reported
from scoup.extract import constants
from scoup.extract.own_views import SHEET
from scoup.extract.photographs import Photograph, read_ahead
from scoup.extract.view_candidates import find_matter, measure_matter
from scoup.extract.view_choice import ViewScorer, choose_views, gains_alone
from scoup.io import (
    RegionManifest,
    RegionStore,
    ScenePaths,
    load_cameras,
    load_gaussians,
    read_points,
    spread_directions,
)
from scoup.raster import prepare_gaussians
from scoup.scene import Camera, Gaussians, nearest_points
from scoup.uplift import measure_fit


def total_wanted(text: str | None, there: int) -> int | None:
    """Return how many photographs "60" or, with ``there`` chosen before, "+40" mean in all; None for no text."""
    if text is None:
        return None
    if not re.fullmatch(r"\+?0*[1-9]\d{0,6}", text):
        raise InputError(f"invalid views {text!r}; expected a number such as 60, more as +40, or all")
    return int(text) + there * text.startswith("+")


@dataclass(frozen=True)
class PhotographChoice:
    """The number of photographs of a scene to choose, and those that were chosen before."""

    scene: Path
    photographs: Sequence[Photograph]
    total: int | None
    """With those there; None: as many as add something, and at least ``FEW``."""
    there: tuple[str, ...]

    @classmethod
    def of(
        cls, scene: Path, photographs: Sequence[Photograph], views: str | None, folder: Path, overwrite: bool,
        is_part: bool,
    ) -> PhotographChoice | None:  # fmt: skip
        """Return the choice for an extraction into a folder; None takes all. ``views`` is a number, more beside those
        chosen before ("+40"), or "all"; None takes all of few."""
        before = None if overwrite else RegionManifest.read(folder)
        there = () if before is None else before.views
        begun = before is not None and not there  # with all
        few = len(photographs) <= constants.FEW or (scene / SHEET).exists()  # own views are few
        if views == "all" or (views is None and (few or begun)):
            return None
        total = total_wanted(views, len(there))
        if views is not None and views.startswith("+"):
            if is_part:
                raise InputError(
                    "`part` needs a total: pass the number of all photographs as `views`, without '+'"
                )
            if before is None:
                raise InputError(f"{folder}: contains no regions to add to; pass `views={views[1:]}`")
            if len(RegionStore.open(folder).views(there)) < len(there):
                total = len(there)  # the same command was interrupted
        return cls(scene, photographs, total, there)

    def choose(self, gaussians: Path | None, images: Path | None, progress: Progress) -> list[Photograph]:
        """Return the photographs that show the most, those there first, by cheap renders of the scene's splat, which
        ``gaussians`` may name, or of COLMAP's points; ``images`` as for ``find_photographs``.

        Raises:
            InputError: the scene has no cameras, or neither splat nor points, or they do not fit, or no photograph can
                be read.
        """
        cameras, surface = posed_scene(self.scene, self.photographs, gaussians, images)
        posed = [item for item in self.photographs if item.path in cameras]
        read = reported(read_ahead(posed), "photographs", len(posed), progress)
        sharp = {item: sharpness(pixels.image) for item, pixels in read if not isinstance(pixels, ScoupError)}
        if not sharp:
            raise InputError(f"{self.scene}: none of its photographs can be read")
        readable = list(sharp)
        numbers = {item.name: number for number, item in enumerate(readable)}
        rows = [numbers[name] for name in self.there if name in numbers]
        views = [cameras[item.path] for item in readable]
        order = rank_views(views, surface, torch.tensor(list(sharp.values())), self.total, rows, progress)
        return [readable[row] for row in order]


def rank_views(
    cameras: Sequence[Camera],
    gaussians: Gaussians,
    sharp: Tensor,
    count: int | None = None,
    there: Sequence[int] = (),
    progress: Progress = no_progress,
) -> list[int]:
    """Return the numbers of the cameras to take: those there, then by marginal gain (``choose_views``); ``sharp`` [V]
    is the sharpness of their photographs, ``count`` as ``PhotographChoice.total``."""
    matter = measure_matter(gaussians, find_matter(gaussians), torch.tensor([0.0, 0.0, 1.0]).double())
    scorer = ViewScorer.of(
        prepare_gaussians(gaussians), matter, torch.from_numpy(spread_directions(constants.SECTORS)).float()
    )
    scores = scorer.scores(reported(cameras, "choice", len(cameras), progress))
    worth = scores.shown.float() * relative_sharpness(sharp, scores.shown.float())[:, None]
    alone = gains_alone(worth)
    if not bool(alone.any()):
        raise InputError("cameras: none of them shows anything of the scene")

    def greedy(most: int, least_gain: float = 0.0) -> list[int]:
        return choose_views(worth, scores.direction, most, least_gain, there)

    beside = (constants.FEW if count is None else count) - len(there)
    chosen = (
        greedy(len(cameras), constants.LEAST_PHOTOGRAPH_GAIN * float(alone.max())) if count is None else []
    )
    if len(chosen) < beside:
        chosen = greedy(beside)
    taken = {*there, *chosen}
    rest = [view for view in alone.argsort(descending=True, stable=True).tolist() if view not in taken]
    return [*there, *chosen, *rest[: max(0, beside - len(chosen))]]


def sharpness(image: NDArray[np.uint8]) -> float:
    """Return the variance of the Laplacian of the brightness of an image [H, W, 3]."""
    gray = image.astype(np.float32) @ np.array([0.299, 0.587, 0.114], np.float32)
    across = gray[1:-1, :-2] + gray[1:-1, 2:]
    return float((4 * gray[1:-1, 1:-1] - gray[:-2, 1:-1] - gray[2:, 1:-1] - across).var())


def relative_sharpness(sharp: Tensor, shown: Tensor) -> Tensor:
    """Return [V] the sharpness by that of photographs that show the same (``Scores.shown`` [V, M]), 0..1: content
    decides sharpness, too."""
    unit = normalize(shown, dim=1)
    nearest = (unit @ unit.T).argsort(dim=1, descending=True, stable=True)[
        :, : constants.PHOTOGRAPH_NEIGHBOURS
    ]
    usual = sharp[nearest].quantile(constants.SHARP, dim=1)
    return (sharp / usual.clamp(min=1e-9)).clamp(max=1)


def posed_scene(
    scene: str | Path, photographs: Sequence[Photograph], splat: str | Path | None, images: str | Path | None
) -> tuple[dict[Path, Camera], Gaussians]:
    """Return the cameras of photographs by their files, of those that have one, and what they show; arguments and
    errors as of ``PhotographChoice.choose``."""
    loaded = load_cameras(scene, images, distorted="undistort", missing_images="keep")
    every = {camera.image_path: camera for camera in loaded}
    cameras = {item.path: every[item.path] for item in photographs if item.path in every}
    surface = _surface(Path(scene), None if splat is None else Path(splat), [*cameras.values()])
    return cameras, surface


def _surface(scene: Path, splat: Path | None, cameras: Sequence[Camera]) -> Gaussians:
    """Return the splat, which must fit the cameras, or COLMAP's points as Gaussians."""
    paths = ScenePaths(scene)
    try:
        source = paths.splat(splat)
    except InputError:
        cameras_of = paths.cameras()
        if splat is not None or cameras_of.format != "colmap":
            raise
        return points_as_gaussians(read_points(cameras_of.path)[0])
    gaussians = load_gaussians(source.path)
    fit = measure_fit(gaussians, cameras, source.preset)
    if fit.is_hopeless:
        raise InputError(fit.problem(cameras, source.path))
    return gaussians


def points_as_gaussians(positions: NDArray[np.float64]) -> Gaussians:
    """Return round Gaussians at points [P, 3] that reach to their neighbours."""
    if len(positions) < 4:
        raise InputError(f"COLMAP's model has {len(positions)} points, too few to choose photographs by")
    away = torch.from_numpy(nearest_points(positions, 3)[1]).mean(1).float() / 2
    most = float(away.quantile(0.95))
    scales = away.clamp(min=1e-6 * most, max=most)[:, None].expand(-1, 3)
    count = len(positions)
    quats = torch.tensor([1.0, 0.0, 0.0, 0.0]).expand(count, 4)
    means = torch.from_numpy(positions).float()
    return Gaussians(means, quats, scales, torch.full((count,), 0.9), torch.zeros(count, 1, 3))
