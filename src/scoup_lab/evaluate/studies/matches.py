"""Observations of one point in several views: by COLMAP's tracks where the model keeps them; else by Gaussians, in the
views where they contribute most to the pixel under their centre."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch

from scoup import raster
from scoup.base import MissingFileError
from scoup.io import read_tracks
from scoup.scene import Camera, Cameras, Gaussians
from scoup_lab.baselines.pixel_rules import pixel_weights, pixels_under
from scoup_lab.evaluate.studies.study_scene import StudyScene

DOMINANT = 0.5  # of a pixel's weight: a Gaussian that contributes this much is what one sees there

Observation = tuple[str, int]
"""(view, pixel), pixel = row * width + column."""


@dataclass(frozen=True, eq=False)
class Matches:
    """Points and where they are seen."""

    source: str  # "COLMAP tracks" or "Gaussians"
    points: list[list[Observation]]  # the observations of each point, two or more


def matched_points(scene: StudyScene) -> Matches:
    """Match by COLMAP's tracks where the model keeps them, else by Gaussians."""
    rasterised = scene.rasterised
    tracked = tracked_points(scene.labelled.folder / "sparse" / "0", rasterised.cameras)
    if tracked is not None:
        return tracked
    views = [camera for camera in rasterised.cameras if camera.name in rasterised.regions]
    return dominant_gaussians(rasterised.gaussians, views, rasterised.raster_preset)


def tracked_points(folder: Path, cameras: Cameras) -> Matches | None:
    """Return points of a COLMAP model in the images of their tracks, at the pixels they project to; None if it keeps no
    tracks."""
    try:
        positions, tracks = read_tracks(folder)
    except MissingFileError:
        return None
    known = {camera.name: camera for camera in cameras}
    stems = {camera.stem: camera for camera in cameras}
    points = []
    for position, names in zip(torch.from_numpy(positions), tracks, strict=True):
        track = []
        for name in names:
            camera = known.get(name) or stems.get(Path(name).name.split(".", 1)[0])
            pixel = -1 if camera is None else int(pixels_under(position[None], camera)[0])
            if camera is not None and pixel >= 0:
                track.append((camera.name, pixel))
        if len(track) > 1:
            points.append(track)
    return Matches("COLMAP tracks", points) if points else None


def dominant_gaussians(
    gaussians: Gaussians, cameras: Sequence[Camera], raster_preset: str = "inria"
) -> Matches:
    """Return Gaussians in the views where they contribute more than half of the pixel under their centre."""
    seen: dict[int, list[Observation]] = {}
    for camera in cameras:
        centres = pixels_under(gaussians.means, camera)
        for pairs in pixel_weights(raster.project(gaussians, camera, raster_preset)):
            chosen = pairs.kept((centres[pairs.gaussian] == pairs.pixel) & (pairs.weight > DOMINANT))
            for gaussian, pixel in zip(chosen.gaussian.tolist(), chosen.pixel.tolist(), strict=True):
                seen.setdefault(gaussian, []).append((camera.name, pixel))
    return Matches("Gaussians", [track for _, track in sorted(seen.items()) if len(track) > 1])
