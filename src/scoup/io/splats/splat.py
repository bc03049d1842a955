""".splat files: 32 bytes per Gaussian, colour without view dependence."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from scoup.base import FileFormatError, atomic_file, counted, existing_file, share_of
from scoup.io.splats.activation import finite_arrays, keep_finite, unit_quats
from scoup.io.splats.splat_format import SplatFormat, kind_inside
from scoup.scene import SH_C0, Gaussians

_ROW = np.dtype([("center", "<f4", 3), ("scale", "<f4", 3), ("color", "u1", 4), ("rotation", "u1", 4)])
_MOST = 1e9  # of a coordinate or scale
_FEW = 0.05  # share of rows that may be damaged


def read_splat(path: str | Path) -> Gaussians:
    """Read a .splat file: linear scales, RGBA bytes, quaternion bytes (b - 128) / 128 as w, x, y, z."""
    path = existing_file(path, "a .splat file")
    try:
        with open(path, "rb") as stream:
            kind = kind_inside(stream.read(64))
        if kind:
            problem = f"is not a .splat file; its content is {kind}"
            raise FileFormatError(path, problem, "give it the ending of its kind, or export it again")
        size = os.path.getsize(path)
        if size % _ROW.itemsize or not size:
            problem = (
                "is empty"
                if not size
                else f"has {counted(size, 'byte')}, which is not a multiple of {_ROW.itemsize}"
            )
            raise FileFormatError(
                path, problem, "it is cut short or not a .splat file; copy or export it again"
            )
        rows = np.fromfile(path, dtype=_ROW)
    except OSError as error:
        raise FileFormatError.unreadable(path, error) from error
    values = np.concatenate([rows["center"], rows["scale"]], axis=1)
    absurd = int((np.abs(values) > _MOST).any(1).sum())
    if absurd > _FEW * len(rows):
        problem = f"is not a .splat file: {share_of(absurd, len(rows), 'row')} have values beyond {_MOST:.0e}"
        raise FileFormatError(path, problem, "copy or export it again")
    color = rows["color"].astype(np.float64) / 255.0
    return keep_finite(
        means=rows["center"],
        quats=unit_quats((rows["rotation"].astype(np.float64) - 128.0) / 128.0),
        scales=np.abs(rows["scale"]),  # the sign of an axis does not change the Gaussian
        opacities=color[:, 3].astype(np.float32),
        sh=((color[:, None, :3] - 0.5) / SH_C0).astype(np.float32),
        source=str(path),
    )[0]


def write_splat(gaussians: Gaussians, path: str | Path, overwrite: bool = False) -> None:
    """Write a .splat file. Colour, opacity and rotation are rounded to bytes; SH above degree 0 is left out."""
    arrays = finite_arrays(gaussians, path)
    rows = np.zeros(len(gaussians), dtype=_ROW)
    rows["center"], rows["scale"] = arrays["means"], arrays["scales"]
    rows["color"][:, :3] = _bytes((arrays["sh"][:, 0] * SH_C0 + 0.5) * 255.0)
    rows["color"][:, 3] = _bytes(arrays["opacities"] * 255.0)
    rows["rotation"] = _bytes((arrays["quats"] + 1.0) * 128.0)
    with atomic_file(path, overwrite) as stream:
        stream.write(rows.tobytes())


def _bytes(values: np.ndarray) -> np.ndarray:
    return np.rint(values).clip(0, 255).astype(np.uint8)


FORMAT = SplatFormat(".splat", (".splat",), read_splat, write_splat)
