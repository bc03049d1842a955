"""Files and folders that have to be there before they are read."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

from scoup.base.errors import FileFormatError, MissingFileError

_POINTER = b"version https://git-lfs"
_MOST_OF_POINTER = 1024  # bytes


def existing_file(path: str | Path, what: str, remedy: str = "check the path") -> Path:
    """Return ``path`` if it is a file.

    Raises:
        MissingFileError: it is not.
        FileFormatError: see ``refuse_pointer``.
    """
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
