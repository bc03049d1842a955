"""The records COLMAP's files hold, binary or text."""

from __future__ import annotations

from dataclasses import dataclass

# COLMAP's model number, name and number of parameters.
MODELS = (
    (0, "SIMPLE_PINHOLE", 3),
    (1, "PINHOLE", 4),
    (2, "SIMPLE_RADIAL", 4),
    (3, "RADIAL", 5),
    (4, "OPENCV", 8),
    (5, "OPENCV_FISHEYE", 8),
    (6, "FULL_OPENCV", 12),
    (7, "FOV", 5),
    (8, "SIMPLE_RADIAL_FISHEYE", 4),
    (9, "RADIAL_FISHEYE", 5),
    (10, "THIN_PRISM_FISHEYE", 12),
    (11, "RAD_TAN_THIN_PRISM_FISHEYE", 16),
    (12, "SIMPLE_DIVISION", 4),
    (13, "DIVISION", 5),
    (14, "SIMPLE_FISHEYE", 3),
    (15, "FISHEYE", 4),
    (16, "EUCM", 6),
    (17, "EQUIRECTANGULAR", 2),
)
MODEL_NAMES = {number: name for number, name, _ in MODELS}
PARAMETER_COUNTS = {name: count for _, name, count in MODELS}


@dataclass(frozen=True)
class Lens:
    """One entry of COLMAP's cameras file: model name, size in pixels, parameters in the model's order."""

    model: str
    width: int
    height: int
    parameters: tuple[float, ...]


@dataclass(frozen=True)
class Shot:
    """One entry of COLMAP's images file: world-to-camera quaternion (w, x, y, z) and translation."""

    number: int
    name: str
    lens: int
    quaternion: tuple[float, ...]
    translation: tuple[float, ...]
