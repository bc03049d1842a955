"""Region maps and embeddings in the LangSplat layout: ``<stem>_s.npy`` and ``<stem>_f.npy`` per image."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from scoup.base.atomic import atomic_file, check_output
from scoup.base.errors import FileFormatError, InputError
from scoup.io.reading import existing_folder
from scoup.io.regions.compact import holds_compact, load_compact
from scoup.io.regions.langsplat_files import (
    FILE_LEVELS,
    copy_labels,
    level_blocks,
    open_langsplat_view,
    open_planes,
    open_rows,
)
from scoup.io.regions.views import (
    FOLDER_NAME,
    at_camera,
    check_aspect,
    check_stems,
    refuse_without_features,
    stem_of,
    unit_rows,
    view_files,
    warn_of_missing,
)
from scoup.io.regions.views import REMEDY as _REMEDY
from scoup.scene.cameras import Camera, Cameras
from scoup.scene.regions import LEVELS, RegionMap, Regions


@dataclass(frozen=True)
class _Files:
    """The two files of one camera, and the row blocks of their levels once somebody asked."""

    camera: Camera
    stem: Path
    blocks: dict[str, slice] = field(default_factory=dict)
    lock: threading.Lock = field(default_factory=threading.Lock)

    @property
    def labels(self) -> Path:
        return self.stem.with_name(f"{self.stem.name}_s.npy")

    @property
    def embeddings(self) -> Path:
        return self.stem.with_name(f"{self.stem.name}_f.npy")


def load_regions(folder: str | Path, cameras: Cameras | Iterable[Camera]) -> Regions:
    """Open region features lazily: headers are checked now, maps and embeddings read when asked for.

    Reads LangSplat's layout, and the compact one (told by its manifest; see ``io.compact``).

    Levels are "s", "m", "l" (the file's "default" is left out). Labels come at the camera's size (nearest
    neighbour; undistorted where the camera says so) and count rows of their own level; embeddings are float32
    [R, D] scaled to unit norm.

    Args:
        folder: the features, or a scene folder with ``language_features`` in it.
        cameras: views to find features for, by image name cut at its first dot.

    Raises:
        MissingFileError: there is no such folder, or it has features of none of the cameras.
        FileFormatError: a file is damaged, belongs to another image, or holds NaN (some only when loaded).

    Warns:
        ScoupWarning: some cameras have no features; says how many.
    """
    folder = existing_folder(folder, "a folder of language features", "make them first, or check the path")
    if (folder / FOLDER_NAME).is_dir():
        folder = folder / FOLDER_NAME
    views: dict[str, _Files] = {}
    cameras = list(cameras)
    if not cameras:
        raise InputError(f"{folder}: cannot load regions for no cameras; give at least one camera")
    check_stems(folder, (camera.name for camera in cameras))
    if holds_compact(folder):
        return load_compact(folder, cameras)
    for camera in cameras:
        files = _Files(camera, folder / camera.stem)
        if files.labels.is_file() and files.embeddings.is_file():
            views[camera.name] = files
    if not views:
        there = [path.name for path in view_files(folder, "_s.npy")]
        refuse_without_features(folder, cameras, ("_s.npy", "_f.npy"), there)
    warn_of_missing(folder, len(views), len(cameras))
    _check_headers(list(views.values()))
    return Regions(
        LEVELS,
        views,
        load=lambda name, level: _load_map(views[name], level),
        load_embeddings=lambda name, level: _load_embeddings(views[name], level),
        load_labels=lambda name: _load_labels(views[name], LEVELS),
    )


def save_regions(regions: Regions, folder: str | Path, overwrite: bool = False) -> None:
    """Write regions with levels s, m, l in the LangSplat layout, at their own size; "default" stays empty.

    Files are named by the view names cut at their first dot.

    Raises:
        OutputExistsError: a file is there already and ``overwrite`` is false; then nothing is written.
        InputError: other levels, or two views with one stem.
    """
    if regions.levels != LEVELS:
        raise InputError(f"the LangSplat layout holds levels {list(LEVELS)}, not {list(regions.levels)}")
    folder = Path(folder)
    stems = {name: stem_of(name) for name in regions.view_names}
    if len(set(stems.values())) < len(stems):
        raise InputError(
            f"{folder}: two views share a file name when cut at the first dot; rename one of them"
        )
    for stem in stems.values():
        check_output(folder / f"{stem}_s.npy", overwrite)
        check_output(folder / f"{stem}_f.npy", overwrite)
    for name, stem in stems.items():
        maps = {level: regions.load(name, level) for level in LEVELS}
        if len({tuple(item.labels.shape) for item in maps.values()}) > 1:
            raise InputError(f"{folder}: the levels of view {name!r} differ in size; resize them to one")
        labels = {level: item.labels.cpu().numpy() for level, item in maps.items()}
        rows = {level: item.embeddings.cpu().numpy() for level, item in maps.items()}
        write_langsplat_view(folder / stem, labels, rows, overwrite)


def write_langsplat_view(
    stem: Path,
    labels: Mapping[str, NDArray[np.int32]],
    embeddings: Mapping[str, NDArray[np.floating]],
    overwrite: bool = False,
) -> int:
    """Write one view as ``<stem>_s.npy`` and ``<stem>_f.npy``.

    Args:
        stem: folder and name without ending.
        labels: level -> [H, W] row of that level's embeddings, or -1; levels that are missing stay empty.
        embeddings: level -> [R, D], written as float32.

    Returns:
        Bytes of both files.

    Raises:
        OutputExistsError: a file is there already and ``overwrite`` is false.
    """
    first = next(iter(labels.values()))
    planes = np.full((len(FILE_LEVELS), *first.shape), -1, np.float32)
    blocks: list[NDArray[np.float32]] = []
    start = 0
    for number, level in enumerate(FILE_LEVELS):
        if level in labels:
            planes[number] = np.where(labels[level] >= 0, labels[level] + start, -1)
            blocks.append(np.asarray(embeddings[level], np.float32))
            start += len(blocks[-1])
    arrays = {f"{stem.name}_f.npy": np.concatenate(blocks), f"{stem.name}_s.npy": planes}
    for name in arrays:
        check_output(stem.with_name(name), overwrite)
    for name, array in arrays.items():
        _save_array(array, stem.with_name(name), overwrite)
    return sum(array.nbytes for array in arrays.values())


def _check_headers(views: list[_Files]) -> None:
    first: tuple[int, Path] | None = None
    for files in views:
        _, planes, rows = open_langsplat_view(files.stem)
        height, width = planes.shape[1:]
        check_aspect(files.labels, width, height, files.camera)
        if first is not None and rows.shape[1] != first[0]:
            raise FileFormatError(
                files.embeddings,
                f"has {rows.shape[1]} dimensions, but {first[1].name} has {first[0]}",
                "the features come from different models; " + _REMEDY,
            )
        first = first or (rows.shape[1], files.embeddings)


def _blocks(files: _Files) -> dict[str, slice]:
    """The row blocks of the levels; both files are read and checked for them, once."""
    with files.lock:
        if not files.blocks:
            path, planes, rows = open_langsplat_view(files.stem)
            files.blocks.update(level_blocks(path, planes, len(rows)))
        return files.blocks


def _load_embeddings(files: _Files, level: str) -> Tensor:
    block = _blocks(files)[level]
    rows = open_rows(files.embeddings)
    if block.stop > len(rows):
        raise _changed(files.embeddings)
    return unit_rows(files.embeddings, rows[block])


def _load_labels(files: _Files, levels: Sequence[str]) -> Tensor:
    """[levels, H, W] int32 labels at the camera's size; embeddings are not read once the blocks are known."""
    blocks = _blocks(files)
    planes = open_planes(files.labels)
    labels = np.empty((len(levels), *planes.shape[1:]), np.int32)
    for number, level in enumerate(levels):
        block = blocks[level]
        if not copy_labels(planes[FILE_LEVELS.index(level)], block, labels[number]):
            raise _changed(files.labels)
    return at_camera(torch.from_numpy(labels), files.camera)


def _changed(path: Path) -> FileFormatError:
    return FileFormatError(path, "has changed since it was opened", "open the features again")


def _load_map(files: _Files, level: str) -> RegionMap:
    return RegionMap(_load_labels(files, (level,))[0], _load_embeddings(files, level))


def _save_array(array: np.ndarray, path: Path, overwrite: bool) -> None:
    with atomic_file(path, overwrite) as stream:
        np.save(stream, array, allow_pickle=False)
