"""Compressed PLY (PlayCanvas, SuperSplat): 16 bytes per Gaussian, quantised within blocks of 256."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from scoup.base import FileFormatError, atomic_file
from scoup.io.splats.activation import finite_arrays, keep_finite, scales_from_logs, unit_quats
from scoup.io.splats.ply_header import MIP, read_header, rest_names
from scoup.io.splats.ply_rows import read_rows
from scoup.io.splats.rotation import with_largest, without_largest
from scoup.scene import SH_C0, Gaussians

_BLOCK = 256  # Gaussians
_PACKED = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
_RANGES = (("", "xyz"), ("scale_", "xyz"), ("", "rgb"))  # of a block: prefixes and names of properties
_SH_RANGE = 8.0  # bytes of higher SH cover -4 to 4
_LEAST_LOG_SCALE, _MOST_LOG_SCALE = -20.0, 20.0  # as the format's own writer has it
# Bits of the numbers in a word, the first of them highest.
_BITS_OF_THREE, _BITS_OF_COLOR, _BITS_OF_ROTATION = (11, 10, 11), (8, 8, 8, 8), (10, 10, 10)


def is_compressed(names: tuple[str, ...]) -> bool:
    """Return whether vertices with these properties are packed."""
    return set(_PACKED) <= set(names)


def read_compressed(path: Path, vertices: np.ndarray) -> Gaussians:
    """Read the Gaussians of the packed vertices [N] of a compressed PLY; the file has the value ranges of each block
    (element ``chunk``) and, maybe, ``sh``."""
    packed = {name: vertices[name] for name in _PACKED}
    if any(column.dtype.kind != "u" or column.dtype.itemsize != 4 for column in packed.values()):
        raise _damaged(path, "has packed properties that are not uint")
    header = read_header(path, "chunk")
    blocks = read_rows(header)
    if len(blocks) * _BLOCK < len(vertices):
        raise _damaged(path, f"has {len(blocks)} chunks for {len(vertices)} vertices")
    block = np.arange(len(vertices)) // _BLOCK
    with np.errstate(all="ignore"):  # ranges may hold anything; rows that are not finite are dropped
        centers = _within(path, blocks, block, "", "xyz", _numbers(packed["packed_position"], _BITS_OF_THREE))
        log_scales = _within(
            path, blocks, block, "scale_", "xyz", _numbers(packed["packed_scale"], _BITS_OF_THREE)
        )
        color = _numbers(packed["packed_color"], _BITS_OF_COLOR)
        rgb = color[:, :3]
        if "min_r" in (blocks.dtype.names or ()):  # older files store colours without ranges
            rgb = _within(path, blocks, block, "", "rgb", rgb)
        higher = _higher_sh(path, header.elements, len(vertices))
        sh = np.concatenate([((rgb - 0.5) / SH_C0)[:, None], higher], axis=1)
        return keep_finite(
            means=centers.astype(np.float32),
            quats=unit_quats(_quats(packed["packed_rotation"])),
            scales=scales_from_logs(log_scales),
            opacities=color[:, 3].astype(np.float32),
            sh=sh.astype(np.float32),
            source=str(path),
        )[0]


def _within(
    path: Path, blocks: np.ndarray, block: np.ndarray, prefix: str, axes: str, share: np.ndarray
) -> np.ndarray:
    """Return [N, 3] float64: ``share`` of the way from the minimum to the maximum of each row's block."""
    names = [f"{end}_{prefix}{axis}" for end in ("min", "max") for axis in axes]
    if not set(names) <= set(blocks.dtype.names or ()):
        raise _damaged(path, f"lacks {names[0]} or a similar property in its chunks")
    ends = np.stack([blocks[name].astype(np.float64) for name in names], axis=1)[block]
    return ends[:, :3] * (1.0 - share) + ends[:, 3:] * share


def _higher_sh(path: Path, elements: tuple[str, ...], count: int) -> np.ndarray:
    """Return [N, B - 1, 3] coefficients above degree 0."""
    if "sh" not in elements:
        return np.zeros((count, 0, 3))
    rows = read_rows(read_header(path, "sh"))
    names = rest_names(rows.dtype.names or ())
    if len(rows) != count or names is None:
        problem = f"has {len(rows)} SH rows of {len(rows.dtype.names or ())} properties for {count} vertices"
        raise _damaged(path, problem)
    if not names:
        return np.zeros((count, 0, 3))
    stored = np.stack([rows[name] for name in names], axis=1)
    # A byte means the middle of its 256th; the first and the last for the ends.
    shares = np.where(stored == 0, 0.0, np.where(stored == 255, 1.0, (stored + 0.5) / 256.0))
    return ((shares - 0.5) * _SH_RANGE).reshape(count, 3, len(names) // 3).transpose(0, 2, 1)


def write_compressed_ply(gaussians: Gaussians, path: str | Path, overwrite: bool = False) -> None:
    """Write a compressed PLY; docs/formats.md says how values are rounded.

    The Gaussians stay in their order, so that a field built on them fits the file. The format's own tools sort them
    first, by which blocks get smaller and values finer.
    """
    arrays = finite_arrays(gaussians, path)
    count = len(gaussians)
    with np.errstate(all="ignore"):
        logs = np.log(arrays["scales"]).clip(_LEAST_LOG_SCALE, _MOST_LOG_SCALE)
    rgb = arrays["sh"][:, 0] * SH_C0 + 0.5
    ranges, shares = zip(*(_shares(values) for values in (arrays["means"], logs, rgb)), strict=True)
    words = [
        _word(shares[0], _BITS_OF_THREE),
        _packed_quats(arrays["quats"]),
        _word(shares[1], _BITS_OF_THREE),
        _word(np.concatenate([shares[2], arrays["opacities"][:, None]], 1), _BITS_OF_COLOR),
    ]
    higher = arrays["sh"][:, 1:].transpose(0, 2, 1).reshape(count, 3 * (arrays["sh"].shape[1] - 1))
    bytes_of_sh = np.floor((higher / _SH_RANGE + 0.5) * 256.0).clip(0, 255).astype(np.uint8)
    with atomic_file(path, overwrite) as stream:
        stream.write(_header(len(ranges[0]), count, higher.shape[1], gaussians.antialiased))
        stream.write(np.concatenate(ranges, 1).astype("<f4").tobytes())
        stream.write(np.stack(words, 1).astype("<u4").tobytes())
        stream.write(bytes_of_sh.tobytes())


def _header(blocks: int, count: int, n_rest: int, antialiased: bool) -> bytes:
    ranges = [f"{end}_{prefix}{axis}" for prefix, axes in _RANGES for end in ("min", "max") for axis in axes]
    comment = MIP if antialiased else "written by SCOUP"
    lines = ["ply", "format binary_little_endian 1.0", f"comment {comment}"]
    lines += [f"element chunk {blocks}", *(f"property float {name}" for name in ranges)]
    lines += [f"element vertex {count}", *(f"property uint {name}" for name in _PACKED)]
    if n_rest:
        lines += [f"element sh {count}", *(f"property uchar f_rest_{number}" for number in range(n_rest))]
    return "\n".join([*lines, "end_header", ""]).encode()


def _shares(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the range of each block [C, 6], float32, and the places of the values in it [N, 3], 0..1."""
    count = len(values)
    starts = np.arange(0, count, _BLOCK)
    low = np.minimum.reduceat(values, starts) if count else np.zeros((0, 3))
    high = np.maximum.reduceat(values, starts) if count else np.zeros((0, 3))
    ends = np.concatenate([low, high], 1).astype(np.float32)
    block = np.arange(count) // _BLOCK
    first, extent = ends[block, :3].astype(np.float64), (ends[:, 3:].astype(np.float64) - ends[:, :3])[block]
    with np.errstate(all="ignore"):
        shares = np.where(extent > 0, (values - first) / extent, 0.0)
    return ends, shares.clip(0, 1)


def _numbers(packed: np.ndarray, bits: tuple[int, ...]) -> np.ndarray:
    """Unpack words [N] to fractions [N, numbers]."""
    columns, shift = [], sum(bits)
    for width in bits:
        shift -= width
        most = (1 << width) - 1
        columns.append((packed >> shift & most) / float(most))
    return np.stack(columns, axis=1)


def _word(shares: np.ndarray, bits: tuple[int, ...]) -> np.ndarray:
    """Return words [N] of fractions [N, numbers]."""
    word = np.zeros(len(shares), np.int64)
    for column, width in enumerate(bits):
        word = word << width | np.rint(shares[:, column] * ((1 << width) - 1)).astype(np.int64)
    return word


def _quats(packed: np.ndarray) -> np.ndarray:
    """Return [N, 4] quaternions w, x, y, z: two bits tell the largest component, the others have ten each."""
    others = (_numbers(packed, _BITS_OF_ROTATION) - 0.5) * np.sqrt(2.0)
    return with_largest((packed >> 30).astype(np.int64), others)


def _packed_quats(quats: np.ndarray) -> np.ndarray:
    """Return [N] words of ``_quats``."""
    which, others = without_largest(quats)
    return which << 30 | _word((others / np.sqrt(2.0) + 0.5).clip(0, 1), _BITS_OF_ROTATION)


def _damaged(path: Path, problem: str) -> FileFormatError:
    return FileFormatError(path, problem, "the file is damaged; export it again")
