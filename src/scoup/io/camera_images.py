"""The photographs of cameras: their folder, files and sizes."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Literal

from scoup.base import FileFormatError, InputError, MissingFileError, ScoupWarning, counted, listed, share_of
from scoup.io.image_folder import EXTENSIONS, ImageFolder
from scoup.io.images import image_size
from scoup.io.reading import sorted_cameras
from scoup.scene import Camera, Cameras

MissingImages = Literal["skip", "keep"]

FACTORS = (1, 2, 4, 8)
ASPECT_TOLERANCE = 0.01
_MOST_NAMED = 20  # images in an error
_ROUNDING = 1.5  # pixels that rounding a scaled size can cost


def attach_images(
    cameras: Cameras,
    source: Path,
    roots: tuple[Path, ...],
    images: str | Path | None,
    downscale: int | None,
    missing_images: MissingImages,
    warn: bool,
) -> Cameras:
    """Return the cameras of a source with their image files, resized to them. ``roots`` are folders that may hold
    ``images``, ``images_2`` and so on; other arguments as of ``scenes.load_cameras``."""
    folder, factor = _choose_folder(roots, images, downscale)
    wanted = downscale or factor
    attached: list[Camera] = []
    others: list[Camera] = []
    missing: list[str] = []
    unreadable: list[str] = []
    misfits: dict[Path, str] = {}
    for camera in cameras:
        path, scale = _find(camera, folder, factor, images is None)
        size = None
        if path is None:
            missing.append(camera.name)
        else:
            try:
                size = image_size(path)
            except FileFormatError as error:
                unreadable.append(str(error))
        if path is None or size is None:
            camera = replace(camera, image_path=None)
            others.append(_resized(source, camera, camera.width / wanted, camera.height / wanted))
        elif misfit := _misfit(camera, size):
            misfits[path] = misfit
        else:
            named = camera.name if PurePosixPath(camera.name).suffix else camera.name + path.suffix
            camera = replace(camera, name=named, image_path=path)
            enlarge = scale / (downscale or scale)
            attached.append(_resized(source, camera, size[0] * enlarge, size[1] * enlarge))
    _refuse(misfits)
    if not attached and not unreadable and images is not None:
        named = listed([camera.name for camera in others])
        raise MissingFileError(
            Path(images), f"has {share_of(0, len(cameras), 'image')} ({named})",
            "use the folder of their photographs",
        )  # fmt: skip
    keep = missing_images == "keep" or not attached
    if unreadable:
        what = "their cameras are used without" if keep else "their cameras are skipped"
        warnings.warn(
            f"{source}: {len(unreadable)} of {counted(len(cameras), 'photograph')} cannot be read, {what}: "
            f"{'; '.join(unreadable[:3])}",
            ScoupWarning,
            stacklevel=3,
        )
    if missing and warn:
        searched = _searched(folder, roots, missing)
        message = f"skipped {len(missing)} of {counted(len(cameras), 'camera')} without an image ({searched})"
        if not attached:
            message = f"{share_of(0, len(missing), 'image')} was found ({searched}); using the cameras alone"
        warnings.warn(f"{source}: {message}", ScoupWarning, stacklevel=3)
    return sorted_cameras(source, [*attached, *(others if keep else [])])


def image_files(
    cameras: Cameras, roots: tuple[Path, ...], images: str | Path | None
) -> tuple[list[tuple[str, Path, Path | None]], str]:
    """Return name, image file and mask of each camera that has an image; and the files that others lack, in words, ""
    if there are none. Only headers of images are read."""
    folder, factor = _choose_folder(roots, images, None)
    missing: list[str] = []
    files: list[tuple[str, Path, Path | None]] = []
    misfits: dict[Path, str] = {}
    for camera in cameras:
        path = _find(camera, folder, factor, images is None)[0]
        if path is None:
            missing.append(camera.name)
            continue
        files.append((camera.name, path, camera.mask_path))
        with suppress(FileFormatError):  # reported by whoever decodes it
            if misfit := _misfit(camera, image_size(path)):
                misfits[path] = misfit
    _refuse(misfits)
    return files, _searched(folder, roots, missing) if missing else ""


def folder_photographs(scene: Path, images: str | Path | None = None) -> dict[str, Path]:
    """Return the photographs of a scene without cameras by their names: those of ``images``, else of its folder
    ``images``, ``images_2`` and so on, else of its own."""
    usual = ("images" if factor == 1 else f"images_{factor}" for factor in FACTORS)
    folders = [scene / name for name in usual if (scene / name).is_dir()] or [scene]
    folders = folders if images is None else [Path(images)]
    for folder in folders:
        if photographs := ImageFolder(folder).photographs():
            return photographs
    remedy = f"pass their folder as `images` ({', '.join(EXTENSIONS)})"
    raise MissingFileError(folders[0], f"has no photographs ({ImageFolder(folders[0]).contents()})", remedy)


def _searched(folder: ImageFolder | None, roots: tuple[Path, ...], missing: list[str]) -> str:
    """Return where images were looked for, and what is there."""
    if folder is None:
        return f"there is no folder {roots[0] / 'images'}"
    others = " and others" if len(missing) > 1 else ""
    return f"looked for {folder.folder / missing[0]}{others}; {folder.contents()}"


def _choose_folder(
    roots: tuple[Path, ...], images: str | Path | None, downscale: int | None
) -> tuple[ImageFolder | None, int]:
    """Return the images folder, and the factor by which its images are reduced; one without images if there is none
    with some."""
    if images is not None:
        for candidate in (Path(images), *(root / images for root in roots)):
            if candidate.is_dir():
                return ImageFolder(candidate), 1
        raise MissingFileError(Path(images), "there is no such folder of images", "check the path")
    order = [downscale, *FACTORS] if downscale else list(FACTORS)
    empty = None
    for root in roots:
        for factor in order:
            folder = root / ("images" if factor == 1 else f"images_{factor}")
            if folder.is_dir():
                listed = ImageFolder(folder)
                if len(listed):
                    return listed, factor
                empty = empty or (listed, 1)
    return empty or (None, 1)


def _find(camera: Camera, folder: ImageFolder | None, factor: int, usual: bool) -> tuple[Path | None, int]:
    """Return the image of a camera and its scale; the reader of the cameras may have found one beside its file, which
    comes first where the folder is a ``usual`` one, and not of smaller images."""
    hint = camera.image_path
    if hint is not None and usual and (folder is None or factor == 1):
        return hint, 1
    path = folder.find(camera.name) if folder is not None else None
    return (path, factor) if path is not None else (hint, 1)


def _misfit(camera: Camera, size: tuple[int, int]) -> str:
    """Return why an image of this size is not of a camera; "" where it can be."""
    width, height = size
    if size == (1, 1) and max(camera.width, camera.height) > max(FACTORS):
        what = f"is a single pixel, but its camera has {camera.width} x {camera.height}"
        return f"{what}: a placeholder, not the photograph"
    expected = camera.height * width / camera.width
    if abs(height - expected) > max(ASPECT_TOLERANCE * expected, _ROUNDING * max(1.0, width / camera.width)):
        what = f"is {width} x {height} pixels"
        return f"{what}, another shape than its camera ({camera.width} x {camera.height})"
    return ""


def _refuse(misfits: Mapping[Path, str]) -> None:
    if not misfits:
        return
    (first, problem), *others = misfits.items()
    named = [problem, *(f"{path} {other}" for path, other in others[: _MOST_NAMED - 1])]
    if len(misfits) > _MOST_NAMED:
        named.append(f"and {counted(len(misfits) - _MOST_NAMED, 'more image')} like these")
    remedy = (
        "use the images these cameras were made with, neither cropped nor rotated, name their folder with `images`, "
        "or remove the folder to use the cameras alone"
    )
    raise FileFormatError(first, "; ".join(named), remedy)


def _resized(source: Path, camera: Camera, width: float, height: float) -> Camera:
    try:
        return camera.resized(max(1, round(width)), max(1, round(height)))
    except InputError as error:  # focal lengths that scaling rounds to nothing
        raise FileFormatError(source, str(error), "the file is damaged") from error
