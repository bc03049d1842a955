"""The files of region sums, checked when read, and mapped into memory (docs/formats.md)."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from scoup.base import FileFormatError, SealedFile, slug

ENDING = ".safetensors"
SCENE = "scene"  # stem of the file that is not a view

_WHAT = "a file of region sums"
_REMEDY = "copy it again, or make the region sums again"


def view_file(view_name: str) -> str:
    """Return the name of a view's file: readable, and unique to this view."""
    return f"view.{slug(view_name)}.{hashlib.sha256(view_name.encode()).hexdigest()[:12]}{ENDING}"


def stored_files(path: Path) -> list[Path]:
    """Return the files of region sums in a folder: that of the scene, and one per view."""
    return sorted(path.glob(f"[!.]*{ENDING}"))


@dataclass(frozen=True, eq=False)
class StoredArrays:
    """The contents of one file."""

    header: dict[str, Any]
    arrays: dict[str, NDArray[Any]]  # backed by the file, or in memory
    bytes: int  # of the file


def read_arrays(path: Path, written: bool = False) -> StoredArrays:
    """Read a file, all of it once, to compare its checksums, unless it has just been ``written``; a FileFormatError if
    it is damaged or of another kind."""
    with SealedFile.open(path, _WHAT, _REMEDY, "check the path", "pt") as file:
        header = json.loads(file.text)
        if "checksums" not in header:
            raise FileFormatError(path, f"is not {_WHAT}", "check the path, or make the region sums again")
        arrays = {name: file.stream.get_tensor(name).numpy() for name in file.stream.keys()}  # noqa: SIM118
        if not written:
            file.check(header, arrays)
    return StoredArrays(header, arrays, path.stat().st_size)
