"""Cameras for a splat without any, chosen by what they show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import torch

from scoup.base.progress import Progress, no_progress
from scoup.extract.scene_up import checked_direction, estimate_up_of_splat
from scoup.extract.view_candidates import candidate_cameras, find_matter, measure_matter, nearby_cameras
from scoup.extract.view_choice import Scores, ViewScorer, choose_views, front_sides
from scoup.raster import prepare_gaussians
from scoup.scene.cameras import Camera, Cameras
from scoup.scene.gaussians import Gaussians

ROUNDS = 2  # of moving the best cameras a little
PARENTS = 24
CHILDREN = 4
LEAST_GAIN = 0.02
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
    from scipy.stats import qmc

    rows = find_matter(gaussians)
    upwards = estimate_up_of_splat(gaussians, rows) if up is None else checked_direction(up)
    matter = measure_matter(gaussians, rows, upwards)
    prepared = prepare_gaussians(gaussians)
    scorer = ViewScorer.of(prepared, matter)
    draws = qmc.Halton(5, scramble=False).random(1 + ROUNDS * CHILDREN)[1:] * 2 - 1
    cameras = candidate_cameras(matter, width, height)
    total, done = len(cameras) + ROUNDS * PARENTS * CHILDREN, 0
    progress("views", done, total)

    def score(some: list[Camera]) -> Scores:
        nonlocal done
        found = []
        for camera in some:
            found.append(scorer.score(camera))
            done += 1
            progress("views", done, total)
        return Scores.of(some, found)

    scores = score(cameras)
    for near in torch.from_numpy(draws).split(CHILDREN):
        parents = choose_views(scores, front_sides(scores, scorer.means), PARENTS, 0, PARENTS)
        moved = nearby_cameras([scores.cameras[view] for view in parents], matter, near)
        scores = Scores.joined([scores, score(moved)])
    fronts = front_sides(scores, scorer.means)
    chosen = choose_views(scores, fronts, count, LEAST_GAIN, MOST_VIEWS)
    return Cameras(
        replace(scores.cameras[view], name=f"view_{number:03d}.png") for number, view in enumerate(chosen)
    )
