"""The splat formats by their suffixes: what reads and what writes each."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from scoup.base.errors import InputError
from scoup.io.splats.axes import USD
from scoup.io.splats.gaussforge_formats import read_through_gaussforge, write_through_gaussforge
from scoup.io.splats.gltf import read_gltf, write_gltf
from scoup.io.splats.ply import read_ply, write_ply
from scoup.io.splats.ply_compressed_write import write_compressed_ply
from scoup.io.splats.splat import read_splat, write_splat
from scoup.io.splats.spz import read_spz, write_spz
from scoup.io.splats.usd import write_usd
from scoup.scene.gaussians import Gaussians

COMPRESSED_PLY = ".compressed.ply"

READERS: dict[str, Callable[[str | Path], Gaussians]] = {
    ".ply": read_ply,
    ".splat": read_splat,
    ".spz": read_spz,
    ".glb": read_gltf,
    ".gltf": read_gltf,
    ".ksplat": read_through_gaussforge,
    ".sog": read_through_gaussforge,
}
"""By suffix, in small letters; compressed PLYs are told by their contents."""

WRITERS: dict[str, Callable[[Gaussians, str | Path, bool], None]] = {
    ".ply": write_ply,
    COMPRESSED_PLY: write_compressed_ply,
    ".splat": write_splat,
    ".spz": write_spz,
    ".glb": write_gltf,
    ".gltf": write_gltf,
    ".ksplat": write_through_gaussforge,
    ".sog": write_through_gaussforge,
    **dict.fromkeys(USD, write_usd),
}


def written_suffix(path: str | Path) -> str:
    """Return the suffix of a name, as ``WRITERS`` knows it."""
    name = Path(path).name.lower()
    return COMPRESSED_PLY if name.endswith(COMPRESSED_PLY) else Path(name).suffix


def check_splat_name(path: str | Path, also: str = "") -> None:
    """Refuse a name that no splat can be written to, before any work.

    Args:
        path: the output.
        also: what else the caller writes, for the message.
    """
    suffix = written_suffix(path)
    if suffix not in WRITERS:
        known = ", ".join(WRITERS) + (f", or {also}" if also else "")
        raise InputError(
            f"{path}: cannot write Gaussians as {suffix or 'a file without extension'}; use one of {known}"
        )
