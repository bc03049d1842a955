"""Cameras for a splat without any, chosen by what they show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from scoup.base.errors import InputError
from scoup.base.progress import Progress, no_progress, reported
from scoup.extract.view_candidates import candidate_cameras, find_matter, measure_matter
from scoup.extract.view_choice import Scores, ViewScorer, choose_views, front_sides
from scoup.raster import prepare_gaussians
from scoup.scene.cameras import Cameras
from scoup.scene.gaussians import Gaussians

LEAST_GAIN = 0.03
MOST_VIEWS = 64


def choose_cameras(
    gaussians: Gaussians,
    *,
    width: int = 960,
    height: int = 720,
    count: int | None = None,
    up: Sequence[float] | None = None,
    progress: Progress = no_progress,
) -> Cameras:
    """Choose cameras for a splat that comes without any, by what cheap renders of many candidates show.

    Args:
        gaussians: N Gaussians.
        width, height: of the images, in pixels.
        count: cameras to choose. By default the fewest that show nearly all that can be seen from several directions.
        up: [3] the direction that is up in the world; by default estimated.

    Returns:
        The cameras, the one that shows the most first.

    Raises:
        InputError: nothing can be seen, or ``up`` is not a direction.

    Example:
        >>> gaussians = scoup.load_gaussians("scene/point_cloud.ply")
        >>> cameras = scoup.choose_cameras(gaussians, width=320, height=240, count=4)
        >>> len(cameras)
        4
    """
    rows = find_matter(gaussians)
    matter = measure_matter(gaussians, rows, _direction(up))
    prepared = prepare_gaussians(gaussians)
    scorer = ViewScorer.of(prepared, matter)
    candidates = candidate_cameras(matter, width, height)
    found = [scorer.score(camera) for camera in reported(candidates, "views", len(candidates), progress)]
    scores = Scores(
        candidates,
        torch.stack([shown.half() for shown, _, _ in found]),
        torch.stack([direction for _, direction, _ in found]),
        torch.tensor([quality for _, _, quality in found]),
    )
    means = prepared.gaussians.means[scorer.counted]
    places = torch.stack([camera.position.float() for camera in candidates])
    fronts = front_sides(scores, means, places)
    chosen = choose_views(scores, fronts, count, LEAST_GAIN, MOST_VIEWS)
    return Cameras(
        replace(candidates[view], name=f"view_{number:03d}.png") for number, view in enumerate(chosen)
    )


def _direction(up: Sequence[float] | None) -> Tensor:
    direction = torch.as_tensor((0.0, -1.0, 0.0) if up is None else tuple(up), dtype=torch.float64).flatten()
    if direction.shape != (3,) or not bool(direction.isfinite().all()) or not float(direction.norm()) > 0:
        raise InputError(f"up: expected three numbers that are not all 0, got {list(up or ())}")
    return direction / direction.norm()
