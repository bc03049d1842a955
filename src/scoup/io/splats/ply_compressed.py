"""Compressed PLY (PlayCanvas, SuperSplat): 16 bytes per Gaussian, quantised within blocks of 256."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from scoup.base.errors import FileFormatError
from scoup.io.splats.activation import keep_finite, scales_from_logs, unit_quats
from scoup.io.splats.ply_header import read_header
from scoup.io.splats.ply_rows import read_rows
from scoup.scene.gaussians import MAX_SH_DEGREE, SH_C0, Gaussians

BLOCK = 256  # Gaussians
_PACKED = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
SH_RANGE = 8.0  # bytes of higher SH cover -4 to 4


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
    if len(blocks) * BLOCK < len(vertices):
        raise _damaged(path, f"has {len(blocks)} chunks for {len(vertices)} vertices")
    block = np.arange(len(vertices)) // BLOCK
    with np.errstate(all="ignore"):  # ranges may hold anything; rows that are not finite are dropped
        centers = _within(path, blocks, block, "", "xyz", _three(packed["packed_position"]))
        log_scales = _within(path, blocks, block, "scale_", "xyz", _three(packed["packed_scale"]))
        color = _bytes(packed["packed_color"])
        rgb = color[:, :3]
        if "min_r" in (blocks.dtype.names or ()):  # older files store colours without ranges
            rgb = _within(path, blocks, block, "", "rgb", rgb)
        higher = _higher_sh(path, header.elements, len(vertices))
        sh = np.concatenate([((rgb - 0.5) / SH_C0)[:, None], higher], axis=1)
        return keep_finite(
            means=centers.astype(np.float32),
            quats=unit_quats(_rotation(packed["packed_rotation"])),
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


def _three(packed: np.ndarray) -> np.ndarray:
    """Unpack 11, 10 and 11 bits to [N, 3] fractions."""
    first, second, third = packed >> 21, packed >> 11 & 1023, packed & 2047
    return np.stack([first / 2047.0, second / 1023.0, third / 2047.0], axis=1)


def _bytes(packed: np.ndarray) -> np.ndarray:
    """Unpack four bytes, highest first, to [N, 4] fractions."""
    return np.stack([(packed >> shift & 255) / 255.0 for shift in (24, 16, 8, 0)], axis=1)


def _rotation(packed: np.ndarray) -> np.ndarray:
    """Return [N, 4] quaternions w, x, y, z: two bits tell the largest component, the others have ten each."""
    others = np.stack([(packed >> shift & 1023) / 1023.0 for shift in (20, 10, 0)], axis=1)
    others = (others - 0.5) * np.sqrt(2.0)
    largest = np.sqrt(np.clip(1.0 - (others**2).sum(1), 0.0, None))
    which = (packed >> 30).astype(np.int64)
    quats = np.empty((len(packed), 4))
    for component in range(4):
        # Components before the largest keep their place among the three, those after move up by one.
        before = np.minimum(component, 2)
        after = np.maximum(component - 1, 0)
        value = np.where(component < which, others[:, before], others[:, after])
        quats[:, component] = np.where(component == which, largest, value)
    return quats


def _higher_sh(path: Path, elements: tuple[str, ...], count: int) -> np.ndarray:
    """Return [N, B - 1, 3] coefficients above degree 0."""
    if "sh" not in elements:
        return np.zeros((count, 0, 3))
    rows = read_rows(read_header(path, "sh"))
    names = [name for name in rows.dtype.names or () if name.startswith("f_rest_")]
    sizes = {3 * ((degree + 1) ** 2 - 1) for degree in range(MAX_SH_DEGREE + 1)}
    ordered = [f"f_rest_{number}" for number in range(len(names))]
    if len(rows) != count or len(names) not in sizes or set(names) != set(ordered):
        raise _damaged(path, f"has {len(rows)} SH rows of {len(names)} for {count} vertices")
    if not ordered:
        return np.zeros((count, 0, 3))
    stored = np.stack([rows[name] for name in ordered], axis=1)
    # A byte means the middle of its 256th; the first and the last for the ends.
    shares = np.where(stored == 0, 0.0, np.where(stored == 255, 1.0, (stored + 0.5) / 256.0))
    return ((shares - 0.5) * SH_RANGE).reshape(count, 3, len(ordered) // 3).transpose(0, 2, 1)


def _damaged(path: Path, problem: str) -> FileFormatError:
    return FileFormatError(path, problem, "the file is damaged; export it again")
