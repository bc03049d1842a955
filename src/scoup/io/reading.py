"""Checks that all readers share: of files, JSON, numbers and cameras."""

from __future__ import annotations

import json
import math
import os
import re
import unicodedata
import warnings
from codecs import BOM_UTF8, BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Literal

import numpy as np
import torch

from scoup.base import FileFormatError, InputError, JsonNode, MissingFileError, ScoupWarning, existing_file
from scoup.scene import Camera, Cameras

Distorted = Literal["refuse", "undistort"]

MAX_IMAGE_SIDE = 100_000  # a longer side is a damaged number, not a photograph
MAX_IMAGE_PIXELS = 1 << 29
_CONTROL = re.compile(rb"[\x00-\x08\x0e-\x1a\x1c-\x1f]")  # not in text

_UNDISTORT_REMEDY = "undistort the images first (colmap image_undistorter), or pass `distorted='undistort'`"


def read_bytes(path: Path) -> bytes:
    """Return the contents of a file; a refusal of the system becomes a FileFormatError."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise FileFormatError.unreadable(path, error) from error


def read_text(path: Path) -> str:
    """Return the contents of a text file in UTF-8, UTF-16 with a byte order mark, or Windows-1252."""
    content = read_bytes(path)
    if content.startswith((BOM_UTF16_LE, BOM_UTF16_BE)):
        with suppress(UnicodeDecodeError):
            return content.decode("utf-16")
    return decoded(path, content.removeprefix(BOM_UTF8))


def decoded(path: Path, content: bytes) -> str:
    """Return text of a file, in UTF-8 or else, with a warning, in Windows-1252."""
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError:
        if _CONTROL.search(content):
            problem, remedy = "is not a text file", "the file is damaged or of another kind"
            raise FileFormatError(path, problem, remedy) from None
    message = f"{path}: is not in UTF-8, and read as Windows-1252; if names look wrong, convert it to UTF-8"
    warnings.warn(message, ScoupWarning, stacklevel=3)
    return content.decode("cp1252", "replace")


def read_json(path: str | Path, what: str, remedy: str = "") -> JsonNode:
    """Return the contents of a JSON file; ``remedy`` is that of values of other types than expected."""
    path = existing_file(path, what)
    text = read_text(path)
    try:
        return JsonNode(path, json.loads(text), remedy or f"the file should contain {what}")
    except (ValueError, RecursionError) as error:
        line = f" (line {error.lineno})" if isinstance(error, json.JSONDecodeError) else ""
        raise FileFormatError(path, f"is not valid JSON{line}", f"the file should contain {what}") from error


def numbered_files(folder: Path, glob: str) -> dict[tuple[int, ...], Path]:
    """Return the files that a glob finds in a folder, by the numbers in place of its stars; others are left out."""
    pattern = re.escape(glob).replace(r"\*", r"(\d{1,12})")
    files = {}
    for file in folder.glob(glob):
        matched = re.fullmatch(pattern, file.relative_to(folder).as_posix())
        if matched and file.is_file():
            files[tuple(map(int, matched.groups()))] = file
    return files


def check_finite(path: Path, values: Sequence[float], what: str) -> list[float]:
    """Return the values if all are finite; ``what`` names one of them in the FileFormatError."""
    for value in values:
        if not math.isfinite(value):
            raise FileFormatError(path, f"{what} is {value}, expected a finite number", "the file is damaged")
    return list(values)


def make_camera(
    path: Path,
    name: str,
    world_to_camera: np.ndarray,
    intrinsics: tuple[float, float, float, float],
    size: tuple[int, int],
    distortion: tuple[float, ...] = (),
    distorted: Distorted = "refuse",
    image_path: Path | None = None,
) -> Camera:
    """Return a camera read from ``path``, checked: a rotation, a size, and distortion only where it is allowed.

    Args:
        world_to_camera: [3, 4] or [4, 4], OpenCV axes.
        intrinsics: fx, fy, cx, cy in pixels of ``size`` (width, height).
        distortion: (k1, k2, p1, p2); all zeros count as none.
    """
    if not all(1 <= side <= MAX_IMAGE_SIDE for side in size) or size[0] * size[1] > MAX_IMAGE_PIXELS:
        problem = f"camera {name!r} has {size[0]} x {size[1]} pixels, not an image size"
        raise FileFormatError(path, problem, "the file is damaged")
    coefficients = tuple(float(item) for item in distortion)
    if not any(coefficients):
        coefficients = ()
    elif distorted == "refuse":
        listed = ", ".join(f"{item:.4g}" for item in coefficients)
        raise FileFormatError(
            path, f"camera {name!r} has lens distortion (k1, k2, p1, p2 = {listed})", _UNDISTORT_REMEDY
        )
    viewmat = np.eye(4)
    viewmat[:3] = world_to_camera[:3]
    if not is_orthogonal(viewmat[:3, :3], 1e-2):
        raise FileFormatError(
            path, f"the pose of camera {name!r} is not a rotation", "remove scale and shear from it"
        )
    fx, fy, cx, cy = intrinsics
    matrix_of_camera = [[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]
    try:
        return Camera(
            name=unicodedata.normalize("NFC", name),
            viewmat=torch.from_numpy(viewmat),
            K=torch.tensor(matrix_of_camera, dtype=torch.float64),
            width=size[0],
            height=size[1],
            image_path=image_path,
            distortion=coefficients,
        )
    except InputError as error:
        raise FileFormatError(path, str(error), "the file is damaged") from error


def is_orthogonal(matrix: np.ndarray, tolerance: float = 1e-3) -> bool:
    """Return whether a matrix [3, 3] is a rotation, or a mirrored one."""
    with np.errstate(all="ignore"):
        return bool(np.abs(matrix @ matrix.T - np.eye(3)).max() <= tolerance)


def sorted_cameras(path: Path, cameras: list[Camera], remedy: str = "rename one of the images") -> Cameras:
    """Return the cameras in order of their names; ``remedy`` is that of equal names."""
    if not cameras:
        raise FileFormatError(path, "contains no cameras", "register at least one image")
    try:
        return Cameras(sorted(cameras, key=lambda camera: camera.name))
    except InputError as error:
        raise FileFormatError(path, str(error), remedy) from error


def existing_folder(path: str | Path, what: str, remedy: str = "check the path") -> Path:
    if not os.path.isdir(path):
        raise MissingFileError.of(path, what, remedy, "folder")
    return Path(path)
