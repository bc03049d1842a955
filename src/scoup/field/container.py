"""The file of a language field: safetensors with a JSON header, both with checksums; read, checked and written without
torch."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from scoup.base import (
    FileFormatError,
    SealedFile,
    WorldFrame,
    check_format_version,
    invalid_contents,
)
from scoup.field.checks import check_content

SCHEMA = "scoup.language_field"
VERSION = 1
REBUILD = "build the field again, or copy the file again if it was cut short"
INCOMPLETE = "is not a complete language field", REBUILD
_WHAT = "a SCOUP language field"


def read_content(path: Path) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Return header and tensors of a ``.scoup`` file, without torch, and check all of it: version, checksums, contents.

    Raises:
        MissingFileError: there is no such file.
        FieldVersionError: it is of a newer version.
        FileFormatError: it is not a language field, or damaged.
    """
    with SealedFile.open(path, _WHAT, REBUILD, "pass a .scoup file; scoup build writes one") as file:
        header = json.loads(file.text)
        if not isinstance(header, dict) or header.get("schema") != SCHEMA:
            raise FileFormatError(path, f"is a safetensors file, but not {_WHAT}", "check the path")
        arrays = {name: file.stream.get_tensor(name) for name in file.stream.keys()}  # noqa: SIM118
    with invalid_contents(path, *INCOMPLETE):
        check_format_version(path, header["version"], VERSION)
        file.check(header, arrays)
        check_content(header, arrays)
    return header, arrays


def write_world(path: Path, world: WorldFrame) -> None:
    """Write a frame of the world into the file of a field; all tensors keep their bytes.

    Raises:
        MissingFileError, FileFormatError, WriteError: the file cannot be read or replaced.
    """
    header, arrays = read_content(path)
    for name in ("checksum", "checksums", "frame"):
        header.pop(name, None)
    SealedFile.write(path, header | world.entry(), arrays, overwrite=True)


def relative_place(path: Path, target: Path | None) -> str | None:
    """Return the path of a file that another one names, relative to the folder of that one; None for None."""
    if target is None:
        return None
    folder = os.path.realpath(path.parent)  # where ``place_of`` begins
    if folder != os.path.abspath(path.parent):  # a link: a path beside it may not be one beside the folder
        target = target.parent.resolve() / target.name
    try:
        return Path(os.path.relpath(target.absolute(), folder)).as_posix()
    except ValueError:  # another drive on Windows
        return target.absolute().as_posix()


def place_of(path: Path, relative: Any) -> Path | None:
    """Return the path of a file named by another relative to its folder, links followed; None for None."""
    return None if relative is None else Path(os.path.normpath(path.resolve().parent / str(relative)))
