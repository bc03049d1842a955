"""Compressed PLY (PlayCanvas, SuperSplat), written: 16 bytes per Gaussian, quantised within blocks of 256."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from scoup.base.atomic import atomic_file
from scoup.io.splats.activation import finite_arrays, unit_quats
from scoup.io.splats.ply import read_ply
from scoup.io.splats.ply_compressed import BLOCK, SH_RANGE
from scoup.io.splats.ply_header import MIP
from scoup.io.splats.splat_format import SplatFormat
from scoup.scene.gaussians import SH_C0, Gaussians

_RANGES = (("", "xyz"), ("scale_", "xyz"), ("", "rgb"))
_LEAST_LOG_SCALE, _MOST_LOG_SCALE = -20.0, 20.0  # as the format's own writer has it


def write_compressed_ply(gaussians: Gaussians, path: str | Path, overwrite: bool = False) -> None:
    """Write a compressed PLY; docs/formats.md says how values are rounded.

    The Gaussians stay in their order, so that a field built on them fits the file. The format's own tools sort them
    first, by which blocks get smaller and values finer.
    """
    arrays = finite_arrays(gaussians, path)
    count = len(gaussians)
    with np.errstate(all="ignore"):
        logs = np.log(np.abs(arrays["scales"])).clip(_LEAST_LOG_SCALE, _MOST_LOG_SCALE)
    rgb = arrays["sh"][:, 0] * SH_C0 + 0.5
    ranges, shares = zip(*(_shares(values) for values in (arrays["means"], logs, rgb)), strict=True)
    words = [
        _word(shares[0], (11, 10, 11)),
        _rotation(unit_quats(arrays["quats"]).astype(np.float64)),
        _word(shares[1], (11, 10, 11)),
        _word(np.concatenate([shares[2], arrays["opacities"][:, None]], 1), (8, 8, 8, 8)),
    ]
    higher = arrays["sh"][:, 1:].transpose(0, 2, 1).reshape(count, 3 * (arrays["sh"].shape[1] - 1))
    bytes_of_sh = np.floor((higher / SH_RANGE + 0.5) * 256.0).clip(0, 255).astype(np.uint8)
    with atomic_file(path, overwrite) as stream:
        stream.write(_header(len(ranges[0]), count, higher.shape[1], gaussians.antialiased))
        stream.write(np.concatenate(ranges, 1).astype("<f4").tobytes())
        stream.write(np.stack(words, 1).astype("<u4").tobytes())
        stream.write(bytes_of_sh.tobytes())


def _header(blocks: int, count: int, n_rest: int, antialiased: bool) -> bytes:
    chunk = [
        f"property float {end}_{prefix}{axis}"
        for prefix, axes in _RANGES
        for end in ("min", "max")
        for axis in axes
    ]
    vertex = [f"property uint packed_{name}" for name in ("position", "rotation", "scale", "color")]
    lines = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment {MIP if antialiased else 'written by SCOUP'}",
        f"element chunk {blocks}",
        *chunk,
    ]
    lines += [f"element vertex {count}", *vertex]
    if n_rest:
        lines += [f"element sh {count}", *(f"property uchar f_rest_{number}" for number in range(n_rest))]
    return "\n".join([*lines, "end_header", ""]).encode()


def _shares(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the range of each block [C, 6], float32, and the places of the values in it [N, 3], 0..1."""
    count = len(values)
    starts = np.arange(0, count, BLOCK)
    low = np.minimum.reduceat(values, starts) if count else np.zeros((0, 3))
    high = np.maximum.reduceat(values, starts) if count else np.zeros((0, 3))
    ends = np.concatenate([low, high], 1).astype(np.float32)
    block = np.arange(count) // BLOCK
    first, extent = ends[block, :3].astype(np.float64), (ends[:, 3:].astype(np.float64) - ends[:, :3])[block]
    with np.errstate(all="ignore"):
        shares = np.where(extent > 0, (values - first) / extent, 0.0)
    return ends, shares.clip(0, 1)


def _word(shares: np.ndarray, bits: tuple[int, ...]) -> np.ndarray:
    """Return [N] shares 0..1 side by side in 32 bits, the first of them highest."""
    word = np.zeros(len(shares), np.int64)
    for column, width in enumerate(bits):
        word = word << width | np.rint(shares[:, column] * ((1 << width) - 1)).astype(np.int64)
    return word


def _rotation(quats: np.ndarray) -> np.ndarray:
    """Return [N] two bits for the largest of w, x, y, z, ten for each of the others."""
    largest = np.abs(quats).argmax(1)
    rows = np.arange(len(quats))
    quats = quats * np.where(quats[rows, largest] < 0, -1.0, 1.0)[:, None]
    others = quats[np.arange(4)[None] != largest[:, None]].reshape(-1, 3)
    return largest << 30 | _word((others / np.sqrt(2.0) + 0.5).clip(0, 1), (10, 10, 10))


FORMAT = SplatFormat(
    "compressed PLY", (".compressed.ply",), read_ply, write_compressed_ply, keeps_antialiased=True
)
