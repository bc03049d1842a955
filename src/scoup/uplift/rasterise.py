"""The loop over views: each is rasterised once and added to the region sums, unless they contain it unchanged."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

from scoup import raster
from scoup.base import (
    InputError,
    Part,
    Progress,
    check_arguments,
    listed,
    native_core,
    no_progress,
    share_of,
    worked_ahead,
)
from scoup.raster import CombinedLabels, ViewSums
from scoup.scene import Camera, Cameras, Gaussians, Regions
from scoup.uplift import constants
from scoup.uplift.near_plane import scene_preset
from scoup.uplift.settings import BuildSettings, Scale, build_settings
from scoup.uplift.stored_sums import RegionSums

STAGE = "region sums"
READERS = 4  # threads that read views ahead for a GPU; for a CPU there is one


def region_sums(
    gaussians: Gaussians,
    cameras: Cameras,
    regions: Regions,
    settings: BuildSettings | str = "default",
    *,
    path: str | Path | None = None,
    sums: RegionSums | None = None,
    part: Part = Part(),  # noqa: B008 - frozen
    progress: Progress = no_progress,
) -> RegionSums:
    """Rasterise every view that has regions once and keep the sums.

    Args:
        gaussians: the trained scene.
        cameras: posed views; those without regions are skipped.
        regions: label maps; they are resized to the camera.
        settings: ``raster_preset``, ``scale`` and ``backend`` count.
        path: keep the sums in this folder. Views that it contains, with the same label maps and cameras, are not
            rasterised again.
        sums: earlier sums of the scene, to which views are added in place of a folder; not changed, but the folder
            that they are kept in is.
        part: of the views to rasterise; several processes may write the parts of one folder.
        progress: called for the stage "region sums".

    Raises:
        InputError: no camera has regions, folder or sums are of another scene, or an argument is of a wrong type.

    Example:
        >>> gaussians, cameras = scoup.load_gaussians("scene/point_cloud.ply"), scoup.load_cameras("scene")
        >>> sums = scoup.region_sums(gaussians, cameras, scoup.load_regions("scene", cameras))
        >>> sums.levels
        ('s', 'm', 'l')
    """
    check_arguments(
        "region_sums",
        gaussians=(gaussians, Gaussians),
        cameras=(cameras, Cameras),
        regions=(regions, Regions),
        sums=(sums, (RegionSums, type(None))),
        part=(part, Part),
    )
    if sums is not None and path is not None:
        raise InputError("pass `sums` or `path`, not both")
    settings = build_settings(settings)
    views = cameras_with_regions(cameras, regions)
    chosen = part.of(views)
    if sums is not None:
        check_sums(sums, gaussians, regions, settings)
        return add_views(sums, gaussians, chosen, regions, settings.backend, progress)
    sums = open_sums(None if path is None else Path(path), gaussians, regions, settings, views)
    try:
        return add_views(sums, gaussians, chosen, regions, settings.backend, progress)
    finally:
        sums.flush()


def open_sums(
    path: Path | None,
    gaussians: Gaussians,
    regions: Regions,
    settings: BuildSettings,
    cameras: Sequence[Camera] = (),
) -> RegionSums:
    """Return the region sums in a folder, to which views can be added; new ones where there are none, or in memory.

    ``cameras`` are all of the scene, by which new ones take its near plane.

    Raises an InputError for a folder of another scene.
    """
    if path is None or not RegionSums.are_in(path):
        preset = scene_preset(gaussians, cameras, settings.raster_preset, settings.backend)
        return RegionSums.empty(gaussians, regions.levels, preset, path, settings.scale)
    sums = RegionSums.open(path, writable=True)
    check_sums(sums, gaussians, regions, settings)
    return sums


def add_views(
    sums: RegionSums,
    gaussians: Gaussians,
    cameras: Sequence[Camera],
    regions: Regions,
    backend: str | None = None,
    progress: Progress = no_progress,
    prepared: raster.PreparedGaussians | None = None,
) -> RegionSums:
    """Return the sums with these views. Views that ``sums`` lack, or contain with other cameras or label maps, are
    rasterised at their scale. ``prepared`` are the same Gaussians, if they are prepared already.

    ``sums`` are not changed. Interrupted at any moment, their folder contains the views that were complete.
    """
    sums = sums.select(list(sums.views), lambda: [regions.embeddings(level)[1] for level in regions.levels])
    if sums.means is None:
        sums.means = gaussians.means.cpu()[sums.order]
    cameras = [_at_scale(camera, sums.scale) for camera in cameras]
    progress(STAGE, 0, len(cameras))

    def append(camera: Camera, combined: CombinedLabels, view_sums: ViewSums, order: Tensor | None) -> None:
        sums.append(camera.name, replace(view_sums, labels_digest=combined.digest()), camera, order)

    with ThreadPoolExecutor(1) as writer:  # appends a view while the next one is projected
        written: Future[None] | None = None
        for done, (camera, combined) in enumerate(read_labels(regions, cameras, gaussians.device), start=1):
            known = sums.views.get(camera.name)
            if known is not None and known.digests == (camera.fingerprint(), combined.digest()):
                progress(STAGE, done, len(cameras))
                continue
            if not sums.writable:
                raise InputError(
                    f"{sums.path}: lacks the view {camera.name!r}, or it has changed since (camera or label maps); "
                    "add it with `keep_sums`, or run the part that lacks it again"
                )
            prepared = prepared or raster.prepare_gaussians(gaussians, backend)
            projection = raster.project(prepared, camera, sums.raster_preset)
            if written is not None:
                written.result()  # before the next one: if killed, one view at most is lost
            view_sums = raster.region_sums(projection, combined)
            written = writer.submit(append, camera, combined, view_sums, prepared.order)
            progress(STAGE, done, len(cameras))
        if written is not None:
            written.result()
    release_memory()
    return sums


def release_memory() -> None:
    """Give free memory of this process back to the system, after a stage that has used much."""
    core = native_core()
    if core is not None:
        core.release_memory()


def _at_scale(camera: Camera, scale: Scale) -> Camera:
    """Return the camera of the image that region sums are made of."""
    longest = max(camera.width, camera.height)
    return camera.scaled(min(1.0, constants.AUTO_SIDE / longest) if scale == "auto" else scale)


def read_labels(
    regions: Regions, cameras: Sequence[Camera], device: torch.device
) -> Iterator[tuple[Camera, CombinedLabels]]:
    """Yield cameras and the label tuples of their pixels, on the CPU; threads read the next views ahead. Labels for
    a GPU are in pinned memory, which is copied fastest.
    """

    def load(camera: Camera) -> CombinedLabels:
        combined = raster.combine(regions.load_labels(camera.name, camera.width, camera.height))
        return combined if device.type == "cpu" else replace(combined, map=combined.map.pin_memory())

    for camera, future in worked_ahead(load, cameras, 1 if device.type == "cpu" else READERS):
        yield camera, future.result()


def check_sums(sums: RegionSums, gaussians: Gaussians, regions: Regions, settings: BuildSettings) -> None:
    """Raise an InputError for region sums of another scene."""
    wrong = [
        what
        for what, same in (
            ("Gaussians", sums.fingerprint == gaussians.fingerprint()),
            (f"levels ({', '.join(sums.levels)})", sums.levels == tuple(regions.levels)),
            (
                f"rasteriser preset ({sums.raster_preset})",
                # One without a near plane takes that of the sums.
                settings.raster_preset in (sums.raster_preset, sums.raster_preset.partition(":")[0]),
            ),
            (f"scale ({sums.scale})", sums.scale == settings.scale),
        )
        if not same
    ]
    if wrong:
        raise InputError(
            f"{sums.path or 'the region sums'}: made with other {' and '.join(wrong)}; make them from the same splat, "
            "region features, `raster_preset` and `scale`, or omit them"
        )


def cameras_with_regions(cameras: Cameras, regions: Regions) -> list[Camera]:
    """Return the cameras that have region maps, in order; an InputError for none."""
    chosen = [camera for camera in cameras if camera.name in regions]
    if not chosen:
        raise InputError(
            f"{share_of(0, len(cameras), 'camera')} has regions; views with regions: "
            f"{listed(regions.view_names, 5) or 'none'}; check that names agree"
        )
    return chosen
