"""The records of COLMAP's files, binary or text."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# The number of parameters of each model, in the order of COLMAP's numbers.
PARAMETER_COUNTS = {
    "SIMPLE_PINHOLE": 3, "PINHOLE": 4, "SIMPLE_RADIAL": 4, "RADIAL": 5, "OPENCV": 8, "OPENCV_FISHEYE": 8,
    "FULL_OPENCV": 12, "FOV": 5, "SIMPLE_RADIAL_FISHEYE": 4, "RADIAL_FISHEYE": 5, "THIN_PRISM_FISHEYE": 12,
    "RAD_TAN_THIN_PRISM_FISHEYE": 16, "SIMPLE_DIVISION": 4, "DIVISION": 5, "SIMPLE_FISHEYE": 3, "FISHEYE": 4,
    "EUCM": 6, "EQUIRECTANGULAR": 2,
}  # fmt: skip
MODEL_NAMES = tuple(PARAMETER_COUNTS)


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


@dataclass(frozen=True, eq=False)
class Points:
    """The entries of COLMAP's points3D file."""

    positions: np.ndarray  # [P, 3] float64
    colors: np.ndarray  # [P, 3] uint8
    lengths: np.ndarray  # [P] of the tracks
    images: np.ndarray  # numbers of the images in all tracks, one track after the other
