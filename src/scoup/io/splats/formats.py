"""The table of splat formats, and the format of a path."""

from __future__ import annotations

import os
import zipfile
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from scoup.base import FileFormatError, InputError, MissingFileError, Registry, foreign_kind, listed
from scoup.io.reading import read_json
from scoup.io.splats import (
    gaussforge_formats,
    gltf,
    gsplat_checkpoint,
    nerfstudio_checkpoint,
    ply,
    splat,
    spz,
    usd,
)
from scoup.io.splats.splat_format import Preset, SplatFormat

FORMATS = Registry("splat format", "scoup.splat_formats", SplatFormat, (
    ply.FORMAT, ply.COMPRESSED, splat.FORMAT, spz.FORMAT, gltf.FORMAT, gaussforge_formats.KSPLAT,
    gaussforge_formats.SOG, gaussforge_formats.SOG_FOLDER, usd.FORMAT, nerfstudio_checkpoint.FORMAT,
    gsplat_checkpoint.FORMAT,
))  # fmt: skip
"""All formats; in a folder the first that finds a splat is taken."""

_NOT_SPLATS = (".obj", ".fbx", ".stl", ".off", ".las", ".laz", ".e57", ".pcd", ".pts")
_ARCHIVES = (".gz", ".zip", ".7z", ".tar", ".tgz", ".rar", ".zst", ".xz", ".bz2")


@dataclass(frozen=True)
class SplatSource:
    """A trained splat on disk."""

    path: Path  # the file; or a folder, if several files are one splat
    kind: SplatFormat
    preset: Preset  # constants of the rasteriser that it was trained with


def splat_source(path: str | Path) -> SplatSource:
    """Return the splat that a path means: a file, the output folder of a training, or a folder with one splat.

    Raises:
        MissingFileError: there is nothing of the kind.
        FileFormatError: the file is of another kind.
    """
    path = Path(path)
    if os.path.isfile(path):
        kind = format_of(path)
        if kind is None or kind.read is None:
            unknown = "is not a kind of splat known here", f"use one of {read_endings()}"
            raise FileFormatError(path, *(other_format(path) or unknown))
        return SplatSource(path, kind, kind.preset)
    if not os.path.isdir(path):
        raise MissingFileError.of(path, "a trained splat", kind="file or folder")
    for kind in FORMATS.values():
        trained = kind.find(path)
        if trained is not None:
            # A training may have exported its splat in another format.
            source = SplatSource(trained, kind, kind.preset) if trained.is_dir() else splat_source(trained)
            return replace(source, preset=kind.preset)
    return _only_splat(path)


def format_of(path: str | Path) -> SplatFormat | None:
    """Return the format of a file by its name; None if it is not the name of a splat."""
    path = Path(path)
    endings = [
        (len(ending), kind)
        for kind in FORMATS.values()
        for ending in kind.endings
        if path.name.lower().endswith(ending) and kind.has_name(path)
    ]
    return max(endings, key=lambda entry: entry[0])[1] if endings else None


def is_splat_name(path: str | Path, written: bool = False) -> bool:
    """Return whether a file has the name of a splat that is read, or of one that is ``written``."""
    kind = format_of(path)
    return kind is not None and (kind.write if written else kind.read) is not None


def written_format(path: str | Path, also: str = "") -> SplatFormat:
    """Return the format in which a splat of this name is written; an InputError if there is none, which names what
    ``also`` can be written."""
    kind = format_of(path)
    if kind is None or kind.write is None:
        written = [ending for item in FORMATS.values() if item.write is not None for ending in item.endings]
        known = ", ".join(written) + (f", or {also}" if also else "")
        suffix = Path(path).suffix.lower() or "a file without extension"
        raise InputError(f"{path}: cannot write Gaussians as {suffix}; use one of {known}")
    return kind


def read_endings() -> str:
    """Return the endings of splats that are read, for messages."""
    readable = [kind for kind in FORMATS.values() if kind.read is not None]
    return ", ".join(dict.fromkeys(ending for kind in readable for ending in kind.endings))


def other_format(path: Path) -> tuple[str, str] | None:
    """Return why a file of a well-known format is not read, and the remedy; None for other files."""
    suffix = path.suffix.lower()
    with suppress(FileFormatError, zipfile.BadZipFile):
        content = read_json(path, "a splat").value if suffix == ".json" else {}
        entries = zipfile.ZipFile(path).namelist() if suffix == ".npz" else content
        if kind := foreign_kind(entries if isinstance(entries, (dict, list)) else ()):
            return kind
    if suffix == ".lcc":
        return (
            "splats in .lcc files are not read",
            f"convert it with splat-transform (splat-transform {path.name} {path.stem}.ply), or open it in the "
            "SuperSplat editor and export a PLY",
        )
    if format_of(path) is not None:
        return (
            f"{suffix} files are not read, whether they hold a splat or a mesh",
            f"export the trained splat as PLY; read are {read_endings()}",
        )
    if suffix in _NOT_SPLATS:
        return (
            f"a {suffix} file contains a mesh or a point cloud, not a trained splat",
            f"use the splat that training wrote: {read_endings()}",
        )
    if suffix in _ARCHIVES:
        return "is an archive", "unpack it, and use the file or folder inside"
    return None


def _only_splat(folder: Path) -> SplatSource:
    splats = []
    for file in sorted(folder.iterdir()):
        kind = format_of(file)
        # Inria's code copies the sparse points beside its cameras as input.ply.
        if kind and kind.read and kind.in_scenes and file.is_file() and file.name != "input.ply":
            splats.append(SplatSource(file, kind, kind.preset))
    if len(splats) != 1:
        names = listed([source.path.name for source in splats], 5)
        problem = f"contains {len(splats)} splats ({names})" if splats else "contains no trained splat"
        for file in (folder / "meta.json", folder / "params.npz"):
            if not splats and file.is_file() and (kind := other_format(file)):
                raise MissingFileError(file, *kind)
        raise MissingFileError(folder, problem, "name the file of the splat itself")
    return splats[0]
