"""Checks of files and arguments that a user names, before something fails deep inside."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from typing import Any

from scoup.base.errors import FileFormatError, InputError, MissingFileError

_MADE_BY = {
    "Gaussians": "scoup.load_gaussians(path)",
    "Cameras": "scoup.load_cameras(path)",
    "Camera": "scoup.load_cameras(path)[0], or [NAME]",
    "Regions": "scoup.load_regions(folder, cameras)",
    "Field": "scoup.LanguageField.load(path), or scoup.build",
    "RegionSums": "scoup.region_sums(gaussians, cameras, regions)",
    "TextEncoder": "scoup.TextEncoder.open(model_or_table)",
}
"""Type -> what gives one."""

_POINTER = b"version https://git-lfs"
_MOST_OF_POINTER = 1024  # bytes


def existing_file(path: str | Path, what: str, remedy: str = "check the path") -> Path:
    """Return ``path`` if it is a file, and not a pointer (``refuse_pointer``); else raise a MissingFileError."""
    path = Path(path)
    if not os.path.isfile(path):
        raise MissingFileError.of(path, what, remedy)
    refuse_pointer(path)
    return path


def refuse_pointer(path: Path) -> None:
    """Raise a FileFormatError for the pointer to a file that a clone without Git LFS has in its place."""
    with suppress(OSError):  # its reader raises that
        if os.path.getsize(path) < _MOST_OF_POINTER and path.read_bytes().startswith(_POINTER):
            problem = "is a pointer of Git LFS, not the file itself"
            raise FileFormatError(path, problem, "run git lfs pull where it was cloned")


def check_arguments(function: str, **arguments: tuple[Any, type | tuple[type, ...]]) -> None:
    """Refuse arguments of wrong types, in their order: name -> value and the type, or types, expected. ``function`` is
    the name for the message. ``Path`` stands for all that names a path."""
    for name, (value, expected) in arguments.items():
        types = expected if isinstance(expected, tuple) else (expected,)
        if isinstance(value, types) or (Path in types and isinstance(value, (str, os.PathLike))):
            continue
        wanted = "a path" if types[0] is Path else types[0].__name__
        remedy = f"; get one from {_MADE_BY[wanted]}" if wanted in _MADE_BY else ""
        order = f" (the order is {', '.join(arguments)})" if len(arguments) > 1 else ""
        raise InputError(
            f"{function}: the argument {name} is of type {type(value).__name__}, expected {wanted}{order}{remedy}"
        )
