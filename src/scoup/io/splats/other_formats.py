"""Files that are not read but are often given where a splat is expected: what to do with them."""

from __future__ import annotations

from pathlib import Path

from scoup.io.splats.axes import USD
from scoup.io.splats.formats import READERS

READ = f"{', '.join(READERS)}, or a gsplat checkpoint (.pt)"
"""Splats that are read, for messages."""

_SPLATS = (".lcc",)  # those that splat-transform reads
_NOT_SPLATS = (".obj", ".fbx", ".stl", ".off", ".las", ".laz", ".e57", ".pcd", ".pts")
_ARCHIVES = (".gz", ".zip", ".7z", ".tar", ".tgz", ".rar", ".zst", ".xz", ".bz2")


def other_format(path: Path) -> tuple[str, str] | None:
    """Return why a file of a well-known format is not read, and the remedy; None for other files."""
    suffix = path.suffix.lower()
    if suffix in _SPLATS:
        return (
            f"splats in {suffix} files are not read",
            f"convert it with splat-transform (splat-transform {path.name} {path.stem}.ply), or open it in the "
            "SuperSplat editor and export a PLY",
        )
    if suffix in USD:
        return (
            f"{suffix} files are not read, whether they hold a splat or a mesh",
            f"export the trained splat as PLY; read are {READ}",
        )
    if suffix in _NOT_SPLATS:
        return (
            f"a {suffix} file contains a mesh or a point cloud, not a trained splat",
            f"use the splat that training wrote: {READ}",
        )
    if suffix in _ARCHIVES:
        return "is an archive", "unpack it, and use the file or folder inside"
    return None
