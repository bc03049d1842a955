"""Views of a splat without photographs: cameras chosen by what they show, and their renders."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import count as count_from
from pathlib import Path
from typing import Any

import torch

from scoup.base import InputError, Progress, check_output, no_progress, reported, staged
from scoup.extract import constants
from scoup.extract.splat_up import estimate_up_of_splat
from scoup.extract.view_candidates import candidate_cameras, find_matter, measure_matter, nearby_cameras
from scoup.extract.view_choice import Scores, ViewScorer, choose_views, clear_worth, gains_alone
from scoup.io import ScenePaths, load_cameras, load_gaussians, save_png, splat_source, write_transforms
from scoup.pictures import as_picture, contact_sheet, sheet_tile
from scoup.raster import prepare_gaussians, project, region_sums, render_colors
from scoup.scene import Camera, Cameras, Gaussians, checked_direction
from scoup.uplift import scene_preset

LEAST_SIDE, MOST_SIDE, MOST_COUNT = 16, 8192, 1000
TRANSFORMS, IMAGES, SHEET = "transforms.json", "images", "views.png"


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
        InputError: nothing can be seen, ``up`` is not a direction, or a number is out of range.

    Warns:
        ScoupWarning: up is a guess.

    Example:
        >>> gaussians = scoup.load_gaussians("scene/point_cloud.ply")
        >>> cameras = scoup.choose_cameras(gaussians, width=320, height=240, count=4, up=(0, -1, 0))
        >>> len(cameras)
        4
    """
    from scipy.stats import qmc

    for name, value in (("width", width), ("height", height)):
        if not LEAST_SIDE <= value <= MOST_SIDE:
            raise InputError(f"`{name}` must be {LEAST_SIDE} to {MOST_SIDE} pixels, got {value}")
    if count is not None and not 1 <= count <= MOST_COUNT:
        raise InputError(f"`count` must be 1 to {MOST_COUNT} views, got {count}")
    rows = find_matter(gaussians)
    up = gaussians.world.up if up is None else up
    upwards = estimate_up_of_splat(gaussians, rows) if up is None else checked_direction(up)
    matter = measure_matter(gaussians, rows, upwards)
    scorer = ViewScorer.of(prepare_gaussians(gaussians), matter)
    draws = qmc.Halton(5, scramble=False).random(1 + constants.ROUNDS * constants.CHILDREN)[1:] * 2 - 1
    cameras = candidate_cameras(matter, width, height)
    total, numbers = len(cameras) + constants.ROUNDS * constants.PARENTS * constants.CHILDREN, count_from(1)
    progress("cameras", 0, total)

    def counted(some: list[Camera]) -> Iterator[Camera]:
        for camera in some:
            yield camera
            progress("cameras", next(numbers), total)

    scores = scorer.scores(counted(cameras))
    for near in torch.from_numpy(draws).split(constants.CHILDREN):
        parents = choose_views(clear_worth(scores, scorer.means), scores.direction, constants.PARENTS)
        moved = nearby_cameras([scores.cameras[view] for view in parents], matter, near)
        scores = Scores.joined([scores, scorer.scores(counted(moved))]) if moved else scores
    worth = clear_worth(scores, scorer.means)
    least_gain = constants.LEAST_VIEW_GAIN * float(gains_alone(worth).max()) if count is None else 0.0
    chosen = choose_views(worth, scores.direction, count or constants.MOST_VIEWS, least_gain)
    if not chosen:
        raise InputError("gaussians: nothing can be seen clearly (no view shows an opaque, sharp surface)")
    return Cameras(
        replace(scores.cameras[view], name=f"own_{number:03d}.png") for number, view in enumerate(chosen)
    )


@dataclass(frozen=True)
class Coverage:
    """Coverage of a splat by views: shares of its opaque Gaussians, 0..1; where none is opaque, of the visible ones."""

    once: float
    """Share shown by at least one view."""
    often: float
    """Share shown by at least three views."""


def save_views(
    gaussians: Gaussians,
    cameras: Cameras,
    folder: str | Path,
    overwrite: bool = False,
    progress: Progress = no_progress,
) -> Coverage:
    """Render a splat from cameras and write a scene folder that every tool reads.

    It contains ``transforms.json``, ``images/`` and ``views.png``, a sheet of all renders; all appear together.

    Args:
        gaussians: the splat.
        cameras: of the renders, without photographs.
        folder: the scene.
        overwrite: replace these files, and remove images that the replaced transforms.json names.

    Returns:
        What the cameras together show.

    Raises:
        InputError: there are no cameras, or two have one name.
        OutputExistsError: a file is there already.

    Example:
        >>> gaussians = scoup.load_gaussians("scene/point_cloud.ply")
        >>> cameras = scoup.choose_cameras(gaussians, width=320, height=240, count=4, up=(0, -1, 0))
        >>> shown = scoup.save_views(gaussians, cameras, "views")
        >>> shown.once >= shown.often
        True
    """
    folder = Path(folder)
    places = {camera.name: f"{IMAGES}/{camera.name}" for camera in cameras}
    if not len(cameras):
        raise InputError("cameras: there are none to render")
    seen = torch.zeros(len(gaussians), dtype=torch.int32)  # in how many views each Gaussian is
    tiles, preset = [], scene_preset(gaussians, list(cameras))
    before = _images_of_views(folder) if overwrite else []
    stale = [folder / name for name in set(before) - set(places.values())]
    # transforms.json comes last: where it is, the views are whole.
    with staged(folder, [*places.values(), SHEET, TRANSFORMS], overwrite, stale) as hidden:
        for camera in reported(cameras, "views", len(cameras), progress):
            path = hidden / places[camera.name]
            path.parent.mkdir(parents=True, exist_ok=True)
            projection = project(gaussians, camera, preset)
            blank = torch.zeros((1, camera.height, camera.width), dtype=torch.int32)
            seen[region_sums(projection, blank).gaussian.unique()] += 1
            picture = as_picture(render_colors(gaussians, camera, projection))
            save_png(picture, path)
            tiles.append(sheet_tile(picture, len(cameras)))
        save_png(contact_sheet(tiles, [camera.stem for camera in cameras]), hidden / SHEET)
        write_transforms(Cameras(replace(camera, image_path=None) for camera in cameras), hidden / TRANSFORMS)
    opaque = gaussians.opacities >= constants.COVERING_OPACITY
    counted = seen[opaque if bool(opaque.any()) else gaussians.opacities > 0]
    once, often = (float((counted >= least).double().mean()) for least in (1, 3))
    return Coverage(once, often)


def write_own_views(
    splat: Path, out: Path, up: Sequence[float] | None, keep_axes: bool, overwrite: bool, progress: Progress,
    **sizes: Any,
) -> tuple[Cameras, Coverage]:  # fmt: skip
    """Choose cameras for a splat and render their views into a scene folder; with ``keep_axes`` up is in the axes of
    the file, and ``sizes`` are options of ``choose_cameras``. A folder with other cameras is refused."""
    check_output(out / TRANSFORMS, out / SHEET, overwrite=overwrite)
    scene = ScenePaths(out)
    if scene.has_cameras and scene.cameras().path != out / TRANSFORMS:
        raise InputError(f"{out}: is a scene with other cameras; choose another folder with `out`")
    source = splat_source(splat)
    gaussians = load_gaussians(source.path)
    if keep_axes and source.kind.axis is not None:
        turned = source.kind.turned(gaussians)
        own = up or turned.world.up or estimate_up_of_splat(turned, find_matter(turned)).tolist()
        up = source.kind.turned_direction(own)
    cameras = choose_cameras(gaussians, up=up, progress=progress, **sizes)
    return cameras, save_views(gaussians, cameras, out, overwrite, progress)


def _images_of_views(folder: Path) -> list[str]:
    """Return the images named by the transforms.json of earlier views, relative to their folder."""
    if not all((folder / name).is_file() for name in (SHEET, TRANSFORMS)):
        return []
    named = (camera.image_path for camera in load_cameras(folder / TRANSFORMS, distorted="undistort"))
    return [f"{IMAGES}/{path.name}" for path in named if path is not None and path.parent == folder / IMAGES]
