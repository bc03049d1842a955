"""Niantic's .spz: about 20 bytes per Gaussian, compressed (github.com/nianticlabs/spz).

Versions 1 to 4 are read. Version 3 is written, which most programs read and which keeps rotations, unlike 2; or 4.

Axes in the file are those of OpenGL (right, up, back), unless it says others: y and z change their signs on the way, as
in the format's own tools (``axes``).
"""

from __future__ import annotations

import math
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np

from scoup.base import InputError, ScoupWarning, atomic_file, existing_file, share_of
from scoup.io.reading import read_bytes
from scoup.io.splats.activation import finite_arrays, keep_finite, scales_from_logs, unit_quats
from scoup.io.splats.axes import Axis, Columns, flipped, half_turn, turned_world
from scoup.io.splats.rotation import rotated_quats, rotated_sh, with_largest, without_largest
from scoup.io.splats.splat_format import SplatFormat
from scoup.io.splats.spz_container import SpzHeader, read_container, write_container
from scoup.scene import Gaussians

_AXIS: Axis = "x"
# From right, back, down to right, down, front.
_QUARTER = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]], np.float32)
MOST_BITS = 16  # after the binary point of a coordinate
_MOST_FIXED = (1 << 23) - 1  # what 24 bits with a sign hold
_COLOR = 0.15  # of a base colour's coefficient in a byte
_STEPS = (8, 16)  # of a byte, for coefficients of degree 1 and of higher degrees
_ROOT = math.sqrt(0.5)  # the largest value of a component that is not the largest
_LEAST, _MOST = math.exp(-10.0), math.exp(5.9375)  # of scales
_HALF_STEP = math.exp(1 / 32)


def read_spz(path: str | Path) -> Gaussians:
    path = existing_file(path, "a .spz file")
    header, columns = spz_columns(path, read_bytes(path))
    return replace(
        keep_finite(**columns, source=str(path))[0],
        antialiased=header.antialiased,
        world=turned_world(header.world, _AXIS),
    )


def spz_columns(path: Path, content: bytes) -> tuple[SpzHeader, Columns]:
    """Return the header and the values in the bytes of a .spz file; ``path`` is for errors."""
    header, parts = read_container(path, content)
    count = header.count
    byte = {
        name: np.frombuffer(data, np.uint8).reshape(count, header.row_sizes[name])
        for name, data in parts.items()
    }
    with np.errstate(all="ignore"):
        sh = np.empty((count, (header.degree + 1) ** 2, 3))
        sh[:, 0] = (byte["colors"] / 255.0 - 0.5) / _COLOR
        higher = (byte["sh"].astype(np.float64) - 128.0) / 128.0
        higher = higher.reshape(count, sh.shape[1] - 1, 3)
        sh[:, 1:] = _last_turned(higher) if "U" in header.axes else higher
        columns = {
            "means": _positions(header, byte["positions"]).astype(np.float32),
            "quats": unit_quats(_quats(byte["rotations"])),
            "scales": scales_from_logs(byte["scales"] / 16.0 - 10.0),
            "opacities": (byte["alphas"][:, 0] / 255.0).astype(np.float32),
            "sh": sh.astype(np.float32),
        }
    quarter = header.axes[1] in "FB"  # y points forward or back: turned about x
    columns = flipped(columns, [1 if name in ("RBD" if quarter else "RDF") else -1 for name in header.axes])
    if not quarter:
        return header, columns
    return header, {
        **columns,
        "means": columns["means"] @ _QUARTER.T,
        "quats": rotated_quats(columns["quats"], _QUARTER),
        "sh": rotated_sh(columns["sh"], _QUARTER),
    }


def write_spz(gaussians: Gaussians, path: str | Path, overwrite: bool = False, version: int = 3) -> None:
    """Write a .spz file of version 3, or of version 4, which alone has SH degree 4; docs/formats.md says how values are
    rounded."""
    version = 4 if gaussians.sh_degree > 3 else version
    arrays = half_turn(finite_arrays(gaussians, path), _AXIS)
    means, scales, sh = arrays["means"], arrays["scales"], arrays["sh"]
    largest = float(np.abs(means).max(initial=0.0))
    if largest > _MOST_FIXED:
        raise InputError(f"{path}: .spz cannot store coordinates of {largest:.3g}; use another format")
    clipped = int(((scales < _LEAST / _HALF_STEP) | (scales > _MOST * _HALF_STEP)).any(1).sum())
    if clipped:
        warnings.warn(
            f"{path}: {share_of(clipped, len(means), 'Gaussian')} had scales outside of {_LEAST:.2g} to {_MOST:.3g}, "
            "the range of .spz, and were clipped to it",
            ScoupWarning,
            stacklevel=2,
        )
    # The most bits after the binary point that leave room for the largest coordinate.
    bits = next(bits for bits in range(MOST_BITS, -1, -1) if round(largest * (1 << bits)) <= _MOST_FIXED)
    header = SpzHeader(
        version,
        len(means),
        gaussians.sh_degree,
        bits,
        gaussians.antialiased,
        world=turned_world(gaussians.world, _AXIS),
    )
    fixed = np.rint(means * (1 << bits)).astype("<i4")
    higher = _last_turned(sh[:, 1:])
    steps = np.where(np.arange(higher.shape[1]) < 3, *_STEPS)[:, None]  # degree 1, higher ones
    with np.errstate(all="ignore"):
        parts = {
            "positions": np.ascontiguousarray(fixed).view(np.uint8).reshape(-1, 3, 4)[..., :3].tobytes(),
            "alphas": _bytes(arrays["opacities"] * 255.0),
            "colors": _bytes(sh[:, 0] * (_COLOR * 255.0) + 127.5),
            "scales": _bytes((np.log(scales) + 10.0) * 16.0),
            "rotations": _packed_quats(arrays["quats"]),
            # Rounded to steps that compress well.
            "sh": _bytes(np.floor((np.rint(higher * 128.0) + 128.0 + steps // 2) / steps) * steps),
        }
    packed = write_container(header, parts)
    with atomic_file(path, overwrite) as stream:
        stream.write(packed)


def _positions(header: SpzHeader, packed: np.ndarray) -> np.ndarray:
    """Return [N, 3] float64 in the file's axes."""
    if header.version == 1:
        return np.ascontiguousarray(packed).view("<f2").astype(np.float64).reshape(-1, 3)
    parts = packed.reshape(-1, 3, 3).astype(np.int64)
    fixed = parts[..., 0] | parts[..., 1] << 8 | parts[..., 2] << 16
    return (fixed - ((fixed & 0x800000) << 1)) / float(1 << header.fraction_bits)


def _quats(packed: np.ndarray) -> np.ndarray:
    """Return [N, 4] float64 quaternions w, x, y, z, of three bytes (x, y, z; w is not negative) or four."""
    if packed.shape[1] == 3:
        vector = packed / 127.5 - 1.0
        w = np.sqrt(np.clip(1.0 - (vector**2).sum(1), 0.0, None))
        return np.concatenate([w[:, None], vector], axis=1)
    word = np.ascontiguousarray(packed).view("<u4")[:, 0].astype(np.int64)
    fields = np.stack([word >> 20 & 1023, word >> 10 & 1023, word & 1023], axis=1)
    others = (fields & 511) * (_ROOT / 511.0) * np.where(fields & 512, -1.0, 1.0)
    return np.roll(with_largest(word >> 30, others), 1, axis=1)  # from x, y, z, w


def _packed_quats(quats: np.ndarray) -> bytes:
    """Return four bytes each of unit quaternions w, x, y, z."""
    which, others = without_largest(np.roll(quats, -1, axis=1))
    sizes = np.rint(np.abs(others) / _ROOT * 511.0).astype(np.int64).clip(0, 511)
    fields = sizes | (others < 0).astype(np.int64) << 9
    return (which << 30 | fields[:, 0] << 20 | fields[:, 1] << 10 | fields[:, 2]).astype("<u4").tobytes()


def _last_turned(higher: np.ndarray) -> np.ndarray:
    """Change the sign of the last coefficient of degree 4, which the format's own tools turn, though it is even in all
    axes; files are read as they were meant."""
    return np.concatenate([higher[:, :23], -higher[:, 23:]], axis=1)


def _bytes(values: np.ndarray) -> bytes:
    return np.clip(np.nan_to_num(np.rint(values), nan=0.0), 0, 255).astype(np.uint8).tobytes()


FORMAT = SplatFormat("Niantic's .spz", (".spz",), read_spz, write_spz, axis=_AXIS, keeps_antialiased=True)
