"""Multi-view consistency: how alike the features of one point are in two views, raw, after the autoencoder, and after
sparse coding (the last appendix figure of the method's paper).

Observations are matched by COLMAP's tracks where the model keeps them; else by Gaussians, in the views where they paint
most of the pixel under their centre. Only what lies in 2D is compared: nothing is lifted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from statistics import mean
from typing import Any

import numpy as np
import torch
from torch import Tensor

from scoup import raster
from scoup.base.errors import InputError, MissingFileError
from scoup.baselines.autoencoder import LANGSPLAT, AutoencoderSettings, fit_autoencoder
from scoup.baselines.pixel_rules import centre_pixels, pixel_weights
from scoup.evaluate.metrics import bootstrap_interval
from scoup.evaluate.tables import Table
from scoup.io import read_tracks
from scoup.pictures.colors import Picture
from scoup.pictures.plots import interval_plot
from scoup.scene.cameras import Camera, Cameras
from scoup.scene.gaussians import Gaussians
from scoup.scene.regions import Regions
from scoup.uplift.build_settings import BuildSettings
from scoup.uplift.region_codes import learn_codebook

DOMINANT = 0.5  # of a pixel's weight: a Gaussian that paints this much is what one sees there
MOST_PAIRS = 40_000  # of matched observations, drawn at random beyond

Observation = tuple[str, int]
"""(view, pixel), pixel = row * width + column."""


@dataclass(frozen=True, eq=False)
class Matches:
    """Points and where they are seen.

    Attributes:
        source: "COLMAP tracks" or "Gaussians".
        points: the observations of each point, two or more.
    """

    source: str
    points: list[list[Observation]]


@dataclass(frozen=True)
class ConsistencyResult:
    """Cosine between matched observations, at one level.

    Attributes:
        scene, level, features: which.
        cosines: [P] mean over the pairs of each point.
        pairs: how many pairs in all.
        unmatched: mean cosine when the second of each pair is that of another pair drawn at random: features that are
            all alike have a high cosine between matched observations too, and tell nothing.
    """

    scene: str
    level: str
    features: str
    cosines: tuple[float, ...]
    pairs: int
    unmatched: float


def tracked_points(folder: Path, cameras: Cameras) -> Matches | None:
    """Points of a COLMAP model in the images of their tracks, at the pixels they project to; None if it keeps no
    tracks."""
    try:
        positions, tracks = read_tracks(folder)
    except MissingFileError:
        return None
    known = {camera.name: camera for camera in cameras}
    stems = {camera.stem: camera for camera in cameras}
    points = []
    for position, names in zip(torch.from_numpy(positions), tracks, strict=True):
        found = []
        for name in names:
            camera = known.get(name) or stems.get(Path(name).name.split(".", 1)[0])
            pixel = None if camera is None else _pixel(position, camera)
            if camera is not None and pixel is not None:
                found.append((camera.name, pixel))
        if len(found) > 1:
            points.append(found)
    return Matches("COLMAP tracks", points) if points else None


def dominant_gaussians(
    gaussians: Gaussians, cameras: Sequence[Camera], raster_preset: str = "inria"
) -> Matches:
    """Gaussians in the views where they paint more than half of the pixel under their centre."""
    seen: dict[int, list[Observation]] = {}
    for camera in cameras:
        centres = centre_pixels(gaussians, camera)
        for pairs in pixel_weights(raster.project(gaussians, camera, raster_preset)):
            chosen = pairs.kept((centres[pairs.gaussian] == pairs.pixel) & (pairs.weight > DOMINANT))
            for gaussian, pixel in zip(chosen.gaussian.tolist(), chosen.pixel.tolist(), strict=True):
                seen.setdefault(gaussian, []).append((camera.name, pixel))
    return Matches("Gaussians", [found for _, found in sorted(seen.items()) if len(found) > 1])


def _pixel(position: Tensor, camera: Camera) -> int | None:
    x, y, z = (camera.viewmat[:3, :3] @ position.double() + camera.viewmat[:3, 3]).tolist()
    if not z > 0:
        return None
    column, row = int(np.floor(camera.fx * x / z + camera.cx)), int(np.floor(camera.fy * y / z + camera.cy))
    if not (0 <= column < camera.width and 0 <= row < camera.height):
        return None
    return row * camera.width + column


def consistency(
    scene: str,
    matches: Matches,
    cameras: Cameras,
    regions: Regions,
    settings: BuildSettings,
    autoencoder: AutoencoderSettings = LANGSPLAT,
    seed: int = 0,
) -> list[ConsistencyResult]:
    """Cosines of raw, autoencoder-decoded and sparse-decoded features between matched observations, at each level.

    Observations without a region are left out. All three features are of the same pairs.

    Args:
        scene: its name.
        matches: observations of points.
        cameras: views.
        regions: maps and embeddings.
        settings: of the sparse codes.
        autoencoder: schedule of LangSplat's network, one for all levels.
        seed: of network, codebook and draw of pairs.

    Raises:
        InputError: no point is seen twice.
    """
    first, second, point_of_pair = _pairs(matches, seed)
    if not len(first):
        raise InputError(f"{scene}: no point is seen in two views; consistency needs views that overlap")
    embeddings = {level: regions.embeddings(level) for level in regions.levels}
    network = fit_autoencoder(torch.cat([rows for rows, _ in embeddings.values()]), autoencoder, seed)
    results = []
    for level, (rows, of_views) in embeddings.items():
        labels = _labels_of(first + second, cameras, regions, level, of_views)
        one = np.array([labels[observation] for observation in first])
        other = np.array([labels[observation] for observation in second])
        both = (one >= 0) & (other >= 0)
        if not both.any():
            continue
        book = learn_codebook(rows, replace(settings, seed=seed))
        unit = torch.nn.functional.normalize(rows, dim=1)
        sparse = torch.nn.functional.normalize(book.codes.to_dense() @ book.atoms, dim=1)
        features = {"raw": unit, "autoencoder": network.decode(network.encode(rows)), "sparse codes": sparse}
        for name, values in features.items():
            a, b = values[torch.from_numpy(one[both])], values[torch.from_numpy(other[both])]
            cosines = (a * b).sum(1).double().numpy()
            members = np.unique(point_of_pair[both], return_inverse=True)[1]
            means = np.bincount(members, cosines) / np.bincount(members)
            shuffled = torch.from_numpy(np.random.default_rng(seed).permutation(len(b)))
            unmatched = float((a * b[shuffled]).sum(1).double().mean())
            results.append(
                ConsistencyResult(scene, level, name, tuple(means.tolist()), int(both.sum()), unmatched)
            )
    return results


def _pairs(matches: Matches, seed: int) -> tuple[list[Observation], list[Observation], np.ndarray]:
    """Pairs of observations of one point, and its number."""
    found = [(a, b, number) for number, point in enumerate(matches.points) for a, b in combinations(point, 2)]
    if len(found) > MOST_PAIRS:
        drawn = np.sort(np.random.default_rng(seed).choice(len(found), MOST_PAIRS, replace=False))
        found = [found[place] for place in drawn]
    first, second = [pair[0] for pair in found], [pair[1] for pair in found]
    return first, second, np.array([pair[2] for pair in found], np.int64)


def _labels_of(
    observations: Sequence[Observation],
    cameras: Cameras,
    regions: Regions,
    level: str,
    of_views: dict[str, slice],
) -> dict[Observation, int]:
    """Row of the stacked embeddings of each observation; -1 where there is no region."""
    by_view: dict[str, list[int]] = {}
    for view, pixel in observations:
        by_view.setdefault(view, []).append(pixel)
    labels = {}
    for view, pixels in by_view.items():
        if view not in of_views:
            labels |= dict.fromkeys(((view, pixel) for pixel in pixels), -1)
            continue
        camera = cameras[view]
        found = regions.load(view, level).resized(camera.width, camera.height).labels.flatten()
        values = found[torch.tensor(pixels)].tolist()
        start = of_views[view].start
        labels |= {(view, p): v + start if v >= 0 else -1 for p, v in zip(pixels, values, strict=True)}
    return labels


def consistency_table(results: Sequence[ConsistencyResult], sources: dict[str, str]) -> Table:
    """Mean cosine by scene, level and kind of feature, with intervals over points; then means over all scenes and
    levels, each counting alike."""
    rows = []
    means: dict[str, list[tuple[float, float]]] = {}
    for result in results:
        interval = bootstrap_interval(result.cosines, [str(i) for i in range(len(result.cosines))])
        cells = (
            f"{interval.mean:.3f}",
            f"{interval.low:.3f} to {interval.high:.3f}",
            f"{result.unmatched:.3f}",
            f"{interval.mean - result.unmatched:.3f}",
        )
        rows.append((result.features, result.scene, result.level, str(len(result.cosines)), *cells))
        means.setdefault(result.features, []).append((interval.mean, result.unmatched))
    for features, pairs in means.items():
        cosine, unmatched = (mean(part) for part in zip(*pairs, strict=True))
        cells = (f"{cosine:.3f}", "-", f"{unmatched:.3f}", f"{cosine - unmatched:.3f}")
        rows.append((features, "all", "all", "-", *cells))
    notes = tuple(f"{scene}: matched by {source}." for scene, source in sources.items())
    return Table(
        "Multi-view consistency: cosine between matched observations",
        (
            "features",
            "scene",
            "level",
            "points",
            "cosine",
            "95 % interval over points",
            "unmatched",
            "difference",
        ),
        tuple(rows),
        (
            *notes,
            "Unmatched: observations of different points, drawn at random. Features that are all alike are "
            "consistent too.",
            "Codes and network are learned from all regions of the scene, as for a build.",
        ),
    )


def consistency_plot(results: Sequence[ConsistencyResult]) -> Picture:
    """Points with intervals, by scene and level."""
    rows, headings = [], []
    for result in sorted(results, key=lambda each: (each.scene, each.level)):
        interval = bootstrap_interval(result.cosines, [str(i) for i in range(len(result.cosines))])
        rows.append((result.features, *(round(v, 3) for v in (interval.mean, interval.low, interval.high))))
        headings.append(f"{result.scene}, level {result.level}")
    return interval_plot(
        rows, "Multi-view consistency", "cosine between matched observations", 900, headings, digits=3
    )


def consistency_record(results: Sequence[ConsistencyResult], sources: dict[str, str]) -> dict[str, Any]:
    """For JSON."""
    rows = [
        {
            "scene": result.scene,
            "level": result.level,
            "features": result.features,
            "points": len(result.cosines),
            "pairs": result.pairs,
            "cosine": float(np.mean(result.cosines)),
            "unmatched": result.unmatched,
        }
        for result in results
    ]
    return {"matched_by": sources, "results": rows}
