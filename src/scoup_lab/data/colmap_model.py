"""Sparse models of COLMAP, written in its binary form."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from scoup.base import atomic_file, staged
from scoup.scene import Cameras, quats_of_rotations

_COUNT = struct.Struct("<Q")
_LENS = struct.Struct("<iiQQ4d")  # number, model, size, fx, fy, cx, cy
_SHOT = struct.Struct("<I4d3dI")  # number, rotation, translation, number of the lens
_POINT = struct.Struct("<Q3d3BdQ")  # number, position, colour, error, length of the track
_PINHOLE = 1


def write_colmap(
    cameras: Cameras,
    folder: str | Path,
    points: tuple[np.ndarray, np.ndarray] | None = None,
    overwrite: bool = False,
) -> None:
    """Write a binary COLMAP model of PINHOLE cameras, and of points without tracks: [P, 3] positions and [P, 3] uint8
    colours."""
    lenses: dict[tuple[float, ...], int] = {}
    shots = []
    for number, camera in enumerate(cameras, start=1):
        lens = (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)
        number_of_lens = lenses.setdefault(lens, len(lenses) + 1)
        quaternion = quats_of_rotations(camera.viewmat[None, :3, :3])[0].tolist()
        translation = camera.viewmat[:3, 3].tolist()
        shots.append(_SHOT.pack(number, *quaternion, *translation, number_of_lens))
        shots[-1] += camera.name.encode() + b"\0" + _COUNT.pack(0)  # no keypoints
    positions, colors = points if points is not None else (np.zeros((0, 3)), np.zeros((0, 3), np.uint8))
    rows = enumerate(zip(positions.tolist(), colors.tolist(), strict=True), start=1)
    contents = {
        "cameras.bin": [_LENS.pack(number, _PINHOLE, *lens) for lens, number in lenses.items()],
        "images.bin": shots,
        "points3D.bin": [
            _POINT.pack(number, *position, *color, 0.0, 0) for number, (position, color) in rows
        ],
    }
    with staged(Path(folder), list(contents), overwrite) as hidden:
        for name, records in contents.items():
            with atomic_file(hidden / name) as stream:
                stream.write(_COUNT.pack(len(records)) + b"".join(records))
