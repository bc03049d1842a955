"""Region features as ``Regions``: opened lazily, at the size of the cameras, with embeddings of unit norm."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from scoup.base import (
    FileFormatError,
    InputError,
    MissingFileError,
    ScoupWarning,
    check_arguments,
    listed,
    share_of,
)
from scoup.io.cameras.undistort import photograph_pixels, sample_nearest
from scoup.io.regions.manifest import RegionManifest
from scoup.io.regions.store import RegionStore, StoredView, staged_store
from scoup.io.regions.views import REMEDY, ViewRegions
from scoup.scene import LEVELS, Camera, Cameras, RegionMap, Regions, resize_labels

ASPECT_TOLERANCE = 0.02  # LangSplat truncates sizes; more is another image


def load_regions(folder: str | Path, cameras: Cameras | Iterable[Camera]) -> Regions:
    """Open region features lazily: headers are checked now, maps and embeddings are read when they are needed.

    Reads LangSplat's layout and the compact one (``RegionStore``).

    Levels are "s", "m", "l" (a stored level "default" is left out). Labels have the camera's size (nearest
    neighbour; undistorted where the camera says so) and are rows of their own level's embeddings; embeddings are
    float32 [R, D] scaled to unit norm.

    Args:
        folder: the features, or a scene folder with ``language_features`` in it.
        cameras: views to find features for, by image name (docs/formats.md).

    Raises:
        MissingFileError: there is no such folder, or it has features of none of the cameras.
        FileFormatError: a file is damaged, belongs to another image, or holds NaN (some only when loaded).

    Warns:
        ScoupWarning: some cameras have no features, though their photographs were to be extracted; says how many.

    Example:
        >>> regions = scoup.load_regions("scene", scoup.load_cameras("scene"))
        >>> found = regions.load("view_00.png", "s")
        >>> found.labels.shape == (found.labels.shape[0], found.labels.shape[1])
        True
    """
    listed = list(cameras) if isinstance(cameras, Iterable) else [cameras]
    expected = object if all(isinstance(camera, Camera) for camera in listed) else Cameras
    check_arguments("load_regions", folder=(folder, Path), cameras=(cameras, expected))
    store, cameras = RegionStore.open(folder), listed
    if not cameras:
        raise InputError(f"{store.folder}: cannot load regions for no cameras; pass at least one camera")
    stored = store.views(camera.name for camera in cameras)
    views = {camera.name: (camera, stored[camera.name]) for camera in cameras if camera.name in stored}
    if not views:
        raise _without_features(store, cameras)
    chosen = {camera.name for camera in cameras} if store.manifest is None else set(store.manifest.views)
    wanted = [camera.name for camera in cameras if not chosen or camera.name in chosen]
    if lacking := sum(name not in views for name in wanted):
        warnings.warn(
            f"{store.folder}: skipped {lacking} of {len(wanted)} cameras that have no features",
            ScoupWarning,
            stacklevel=2,
        )
    first = next(iter(views.values()))[1]
    for camera, view in views.values():
        _check_view(view, camera, first)

    def labels(name: str, levels: Sequence[str] = LEVELS) -> Tensor:
        camera, view = views[name]
        stored = torch.from_numpy(view.labels(levels))
        if not camera.distortion:
            return resize_labels(stored, camera.width, camera.height)
        pixels = photograph_pixels(camera, stored.shape[-1], stored.shape[-2])
        return torch.stack([sample_nearest(item, pixels, outside=-1) for item in stored])

    def embeddings(name: str, level: str) -> Tensor:
        view = views[name][1]
        return _normalised(view.embeddings_path, view.embeddings(level))

    def load(name: str, level: str) -> RegionMap:
        return RegionMap(labels(name, (level,))[0], embeddings(name, level))

    return Regions(LEVELS, views, load, embeddings, labels)


def save_regions(regions: Regions, folder: str | Path, overwrite: bool = False) -> None:
    """Write regions with levels s, m, l in the compact layout, at their own size, with embeddings of 32 bits."""
    if regions.levels != LEVELS:
        raise InputError(f"region features contain levels {list(LEVELS)}, not {list(regions.levels)}")
    store = RegionStore(Path(folder))
    store.check_names(regions.view_names)
    stems = [store.stem_of(name) for name in regions.view_names]
    with staged_store(store.folder, RegionManifest.of("", {}, 32), stems, overwrite) as out:
        for name in regions.view_names:
            maps = {level: regions.load(name, level) for level in LEVELS}
            if len({tuple(item.labels.shape) for item in maps.values()}) > 1:
                raise InputError(f"{folder}: the levels of view {name!r} differ in size; resize them to one")
            labels = {level: item.labels.cpu().numpy() for level, item in maps.items()}
            rows = {level: item.embeddings.cpu().numpy() for level, item in maps.items()}
            out.write(ViewRegions(name, labels, rows))


def _without_features(store: RegionStore, cameras: Sequence[Camera]) -> MissingFileError:
    """Return the error that says which files were expected and which exist."""
    stems = (store.stem_of(camera.name) for camera in cameras)
    expected = listed([" and ".join(stem + ending for ending in store.endings) for stem in stems])
    there = [stem + store.endings[0] for stem in store.all_stems()]
    actual = f"it has {listed(there)}" if there else f"it has no *{store.endings[0]} files"
    lack = f"has regions of {share_of(0, len(cameras), 'camera')}"
    if len(cameras) == 1:
        lack = f"has no regions of {cameras[0].name}"
    return MissingFileError(
        store.folder,
        f"{lack}: expected {expected}; {actual}",
        "make them with scoup extract, or use the features of these images",
    )


def _check_view(view: StoredView, camera: Camera, first: StoredView) -> None:
    """Refuse a view of other levels, of another image, or of another model than the first view."""
    if not set(LEVELS) <= set(view.levels):
        raise FileFormatError(view.labels_path, f"has levels {list(view.levels)}, not s, m and l", REMEDY)
    if not _same_shape((view.width, view.height), (camera.width, camera.height)):
        raise FileFormatError(
            view.labels_path,
            f"is {view.width} x {view.height}, of another shape than its image ({camera.width} x {camera.height})",
            "these are features of other images; use those of this scene",
        )
    if view.dim != first.dim:
        raise FileFormatError(
            view.embeddings_path,
            f"has {view.dim} dimensions, but {first.embeddings_path.name} has {first.dim}",
            "the features come from different models; " + REMEDY,
        )


def _same_shape(one: tuple[int, int], other: tuple[int, int]) -> bool:
    """Return whether two sizes are of one image: of equal shape, but for a pixel lost by rounding or truncation."""
    small, large = sorted((one, other))
    ratio = (small[0] / small[1]) / (large[0] / large[1])
    most = 1.0 / min(small)  # what a pixel of the smaller one is of its shorter side
    return abs(ratio - 1.0) <= max(ASPECT_TOLERANCE, most) or small == (1, 1)


def _normalised(path: Path, rows: np.ndarray) -> Tensor:
    """Return [R, D] float32 stored embeddings of unit norm, to float32 rounding; ``scene.directions`` is content with
    less, after which other codes would be learned."""
    with np.errstate(invalid="ignore"):  # a signalling NaN; refused below
        wide = np.asarray(rows, dtype=np.float64)
    if not np.isfinite(wide).all():
        raise FileFormatError(path, "has embeddings that are not finite (NaN or infinite)", REMEDY)
    norms = np.linalg.norm(wide, axis=1, keepdims=True)
    # Rows that are unit stay bit for bit; a zero row means "unknown" and stays zero.
    unit = np.where(np.abs(norms - 1.0) < 1e-6, wide, wide / np.where(norms > 0, norms, 1.0))
    return torch.from_numpy(unit.astype(np.float32))
