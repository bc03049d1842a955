"""COLMAP sparse models: cameras, images and points3D, binary or text. Rigs and frames are not needed."""

from __future__ import annotations

from contextlib import suppress
from itertools import islice
from pathlib import Path
from types import ModuleType

import numpy as np
import torch

from scoup.base import FileFormatError, MissingFileError
from scoup.io.cameras import colmap_binary, colmap_text
from scoup.io.cameras.colmap_model import Lens, Shot
from scoup.io.image_folder import warn_of_outside
from scoup.io.reading import Distorted, check_finite, existing_folder, make_camera, sorted_cameras
from scoup.scene import Cameras, rotation_matrices

_FILES = ("cameras", "images")
_PARSERS = {".bin": colmap_binary, ".txt": colmap_text}
"""By ending of the files, the preferred one first."""


def is_model(folder: str | Path) -> bool:
    """Return whether a folder holds a cameras and an images file of COLMAP."""
    return _ending(Path(folder)) is not None


def _ending(folder: Path) -> str | None:
    return next(
        (end for end in _PARSERS if all((folder / f"{name}{end}").is_file() for name in _FILES)), None
    )


def model_images(folder: Path) -> list[Shot]:
    """Return the images of a model; none if its file is damaged."""
    end = _ending(folder)
    with suppress(FileFormatError):
        return _PARSERS[end].read_shots(folder / f"images{end}") if end else []
    return []


def read_colmap(folder: str | Path, distorted: Distorted = "refuse") -> Cameras:
    """Read the cameras of a COLMAP model, binary (preferred) or text, sorted by name.

    SIMPLE_PINHOLE and PINHOLE are read as they are; SIMPLE_RADIAL, RADIAL and OPENCV count as pinhole if
    their coefficients are zero, and otherwise need ``distorted="undistort"``; other models are refused.
    """
    folder = existing_folder(folder, "a COLMAP model folder")
    end = _ending(folder)
    if end is None:
        raise MissingFileError(
            folder,
            "contains no COLMAP model (cameras and images, both .bin or both .txt)",
            "use the folder sparse/0",
        )
    parser = _PARSERS[end]
    lens_path, path = folder / f"cameras{end}", folder / f"images{end}"
    lenses, shots = parser.read_lenses(lens_path), parser.read_shots(path)
    cameras = []
    for shot in shots:
        if shot.lens not in lenses:
            problem = (
                f"image {shot.name!r} refers to camera {shot.lens}, which {lens_path.name} does not have"
            )
            raise FileFormatError(path, problem, "the two files do not belong together")
        intrinsics, distortion = _pinhole(lens_path, lenses[shot.lens])
        size = (lenses[shot.lens].width, lenses[shot.lens].height)
        pose = _pose(path, shot)
        cameras.append(make_camera(lens_path, shot.name, pose, intrinsics, size, distortion, distorted))
    warn_of_outside(path, folder, (camera.name for camera in cameras))
    return sorted_cameras(path, cameras)


def read_points(folder: str | Path) -> tuple[np.ndarray, np.ndarray]:
    """Return the sparse points of a COLMAP model: [P, 3] float64 positions and [P, 3] uint8 colours."""
    parser, path = _points_of(folder)
    points = parser.read_points(path)
    return points.positions, points.colors


def read_tracks(folder: str | Path) -> tuple[np.ndarray, list[list[str]]]:
    """Return the sparse points [P, 3] float64 of a COLMAP model, and for each the names of the images in its track
    (none in models that keep no tracks)."""
    parser, path = _points_of(folder)
    names = {shot.number: shot.name for shot in parser.read_shots(path.with_stem("images"))}
    points = parser.read_points(path)
    if not names.keys() >= set(points.images.tolist()):
        raise FileFormatError(path, "has tracks with a missing image", "the files do not belong together")
    numbers = iter(points.images.tolist())
    tracks = (islice(numbers, length) for length in points.lengths.tolist())
    return points.positions, [list(dict.fromkeys(names[number] for number in track)) for track in tracks]


def _points_of(folder: str | Path) -> tuple[ModuleType, Path]:
    """Return the parser of the points of a model, and their file."""
    folder = existing_folder(folder, "a COLMAP model folder")
    for end, parser in _PARSERS.items():
        if (folder / f"points3D{end}").is_file():
            return parser, folder / f"points3D{end}"
    raise MissingFileError(folder, "contains no points3D.bin or points3D.txt", "use the folder sparse/0")


def _pinhole(
    path: Path, lens: Lens
) -> tuple[tuple[float, float, float, float], tuple[float, float, float, float]]:
    """Return (fx, fy, cx, cy) and (k1, k2, p1, p2) of a lens."""
    values = check_finite(path, lens.parameters, f"a parameter of a {lens.model} camera")
    match lens.model, values:
        case "SIMPLE_PINHOLE", [f, cx, cy]:
            return (f, f, cx, cy), (0.0, 0.0, 0.0, 0.0)
        case "PINHOLE", [fx, fy, cx, cy]:
            return (fx, fy, cx, cy), (0.0, 0.0, 0.0, 0.0)
        case "SIMPLE_RADIAL", [f, cx, cy, k1]:
            return (f, f, cx, cy), (k1, 0.0, 0.0, 0.0)
        case "RADIAL", [f, cx, cy, k1, k2]:
            return (f, f, cx, cy), (k1, k2, 0.0, 0.0)
        case "OPENCV", [fx, fy, cx, cy, k1, k2, p1, p2]:
            return (fx, fy, cx, cy), (k1, k2, p1, p2)
        case _:
            remedy = "make pinhole images with colmap image_undistorter and use its result"
            if lens.model == "EQUIRECTANGULAR":
                remedy = "cut pinhole images out of the panoramas (COLMAP's panorama_sfm.py) and use these"
            raise FileFormatError(path, f"camera model {lens.model} is not supported", remedy)


def _pose(path: Path, shot: Shot) -> np.ndarray:
    """Return [3, 4] world-to-camera."""
    quaternion = np.array(check_finite(path, shot.quaternion, f"rotation of image {shot.name!r}"))
    translation = check_finite(path, shot.translation, f"position of image {shot.name!r}")
    with np.errstate(all="ignore"):
        norm = float(np.linalg.norm(quaternion))
    if not 1e-6 < norm < 1e6:
        raise FileFormatError(
            path, f"image {shot.name!r} has no rotation (quaternion of norm {norm:.3g})", "register again"
        )
    rotation = rotation_matrices(torch.from_numpy(quaternion)[None])[0].numpy()
    return np.concatenate([rotation, np.array(translation)[:, None]], axis=1)
