"""Views added to region sums: each is rasterised once, unless it is in them already and has not changed."""

from __future__ import annotations

import warnings
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from scoup import raster
from scoup.base.arguments import check_arguments
from scoup.base.atomic import remove
from scoup.base.counts import listed, none_of
from scoup.base.errors import FileFormatError, InputError, ScoupWarning
from scoup.base.progress import Progress, no_progress
from scoup.raster import CombinedLabels, ViewSums
from scoup.scene.cameras import Camera, Cameras
from scoup.scene.gaussians import Gaussians
from scoup.scene.regions import Regions
from scoup.uplift.region_sums import RegionSums

STAGE = "region sums"
READERS = 4  # threads that read views for a GPU, each one ahead; for a CPU there is one


def region_sums(
    gaussians: Gaussians,
    cameras: Cameras,
    regions: Regions,
    raster_preset: str = "inria",
    path: str | Path | None = None,
    backend: str | None = None,
    progress: Progress = no_progress,
    **more: Any,
) -> RegionSums:
    """Rasterise every view that has regions once and keep the sums.

    Args:
        gaussians: the trained scene.
        cameras: posed views; those without regions are passed over.
        regions: their label maps; they are brought to the size of the camera.
        raster_preset, backend: see ``raster.project``.
        path: keep the sums in this folder. Views that it holds already, of the same scene and with the same label maps
            and cameras, are not rasterised again.
        progress: called for the stage "region sums".
        more: further arguments of ``RegionSums``.

    Raises:
        InputError: no camera has regions, the folder holds sums of another scene, or an argument is of a wrong type.

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
    )
    chosen = cameras_with_regions(cameras, regions)
    if path is not None and Path(path).exists():
        sums = RegionSums.open(path, writable=True)
        check_sums(sums, gaussians, regions, raster_preset)
    else:
        new = None if path is None else Path(path)
        sums = RegionSums.of(gaussians, regions.levels, raster_preset, path=new, **more)
    add_views(sums, gaussians, chosen, regions, backend, progress)
    sums.rows = [regions.embeddings(level)[1] for level in regions.levels]
    return sums


def resumed(
    path: Path, gaussians: Gaussians, regions: Regions, raster_preset: str = "inria", **more: Any
) -> RegionSums:
    """Region sums in a folder: those an interrupted build has left there, or new ones.

    Args:
        path: the folder; what is there and cannot be continued is replaced, with a warning.
        gaussians, regions, raster_preset: of the build.
        more: further arguments of ``RegionSums``.
    """
    if path.exists():
        try:
            sums = RegionSums.open(path, writable=True)
            check_sums(sums, gaussians, regions, raster_preset)
            wanted = {"weights": "float32", "least_weight": 0.0, **more}
            if wanted != {name: getattr(sums, name) for name in wanted}:
                raise InputError("its weights were kept in another way")
            return sums
        except (InputError, FileFormatError) as error:
            warnings.warn(f"{path}: cannot be continued ({error}); starting over", ScoupWarning, stacklevel=2)
            remove(path)
    return RegionSums.of(gaussians, regions.levels, raster_preset, path=path, **more)


def add_views(
    sums: RegionSums,
    gaussians: Gaussians,
    cameras: Sequence[Camera],
    regions: Regions,
    backend: str | None = None,
    progress: Progress = no_progress,
) -> None:
    """Bring sums up to date with views: those that are not there, or have changed, are rasterised and appended.

    Interrupted at any moment, the sums hold the views that were complete.

    Args:
        sums: of the same Gaussians.
        cameras: views with regions.
    """
    prepared: raster.PreparedGaussians | None = None
    progress(STAGE, 0, len(cameras))

    def append(camera: Camera, combined: CombinedLabels, found: ViewSums, order: Tensor | None) -> None:
        sums.append(camera.name, replace(found, labels_digest=combined.digest()), camera, order)

    with ThreadPoolExecutor(1) as writer:  # a view is appended while the next one is projected
        written: Future[None] | None = None
        for done, (camera, combined) in enumerate(read_labels(regions, cameras, gaussians.device), start=1):
            if holds_view(sums, camera, combined):
                progress(STAGE, done, len(cameras))
                continue
            if not sums.writable:
                raise InputError(
                    f"{sums.path}: lacks the view {camera.name!r}, or it has changed since (camera or label maps); "
                    "add it with scoup update, or build without these region sums"
                )
            prepared = prepared or raster.prepare_gaussians(gaussians, backend)
            projection = raster.project(prepared, camera, sums.raster_preset)
            if written is not None:
                written.result()  # before the next one is begun: killed, one view at most is done again
            found = raster.region_sums(projection, combined)
            written = writer.submit(append, camera, combined, found, prepared.order)
            progress(STAGE, done, len(cameras))
        if written is not None:
            written.result()


def holds_view(sums: RegionSums, camera: Camera, combined: CombinedLabels) -> bool:
    """Whether the sums hold this very view: same camera, same label maps."""
    view = sums.views.get(camera.name)
    return (
        view is not None
        and view.camera_digest == camera.fingerprint()
        and view.labels_digest == combined.digest()
    )


def changed_views(
    sums: RegionSums, cameras: Sequence[Camera], regions: Regions, device: torch.device
) -> list[Camera]:
    """Those of the cameras whose views the sums do not hold, or hold with another camera or other label maps."""
    return [
        camera
        for camera, labels in read_labels(regions, cameras, device)
        if not holds_view(sums, camera, labels)
    ]


def read_labels(
    regions: Regions, cameras: Sequence[Camera], device: torch.device
) -> Generator[tuple[Camera, CombinedLabels], None, None]:
    """Cameras and the combinations of their regions, on a device, view by view.

    Other threads read the next views meanwhile.
    """

    def load(camera: Camera) -> CombinedLabels:
        labels = regions.load_labels(camera.name, camera.width, camera.height)
        if device.type == "cpu":
            return raster.combine(labels)
        return raster.combine(labels.pin_memory().to(device, non_blocking=True))

    n_readers = 1 if device.type == "cpu" else READERS
    yield from _ahead(load, cameras, n_readers)


def _ahead(
    load: Callable[[Camera], CombinedLabels], cameras: Sequence[Camera], n_readers: int
) -> Iterator[tuple[Camera, CombinedLabels]]:
    waiting: deque[tuple[Camera, Future[CombinedLabels]]] = deque()
    with ThreadPoolExecutor(n_readers) as readers:
        try:
            for camera in cameras:
                waiting.append((camera, readers.submit(load, camera)))
                if len(waiting) > n_readers:
                    first, future = waiting.popleft()
                    yield first, future.result()
            while waiting:
                first, future = waiting.popleft()
                yield first, future.result()
        finally:
            for _, future in waiting:
                future.cancel()


def check_sums(sums: RegionSums, gaussians: Gaussians, regions: Regions, raster_preset: str) -> None:
    """Refuse region sums of another scene.

    Raises:
        InputError: they are.
    """
    wrong = [
        what
        for what, same in (
            ("Gaussians", sums.fingerprint == gaussians.fingerprint()),
            (f"levels ({', '.join(sums.levels)})", sums.levels == tuple(regions.levels)),
            (f"rasteriser preset ({sums.raster_preset})", sums.raster_preset == raster_preset),
        )
        if not same
    ]
    if wrong:
        raise InputError(
            f"{sums.path or 'the region sums given'}: made with other {' and '.join(wrong)}; make them from the same "
            "splat, region features and --raster-preset, or leave them away"
        )


def cameras_with_regions(cameras: Cameras, regions: Regions) -> list[Camera]:
    """The cameras that have region maps, in order.

    Raises:
        InputError: there is none.
    """
    chosen = [camera for camera in cameras if camera.name in regions]
    if not chosen:
        raise InputError(
            f"{none_of(len(cameras), 'camera')} has regions; views with regions: "
            f"{listed(regions.view_names, 5) or 'none'}; check that names agree"
        )
    return chosen
