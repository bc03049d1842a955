"""The file of a language field: safetensors with a JSON header, both with checksums; read, checked and written without
torch."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from scoup.base import (
    FileFormatError,
    SealedFile,
    WorldFrame,
    WriteError,
    atomic_path,
    check_format_version,
)
from scoup.field.content import check_content

SCHEMA = "scoup.language_field"
VERSION = 1
REBUILD = "build the field again, or copy the file again if it was cut short"
_WHAT = "a SCOUP language field"


@dataclass(frozen=True, eq=False)
class FieldContent:
    """The header and the tensors of a ``.scoup`` file, checked."""

    header: Mapping[str, Any]
    arrays: Mapping[str, NDArray[Any]]


def read_content(path: Path) -> FieldContent:
    """Read a ``.scoup`` file without torch and check all of it: version, checksums, header and tensors.

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
    with field_damage_named(path):
        check_format_version(path, header["version"], VERSION)
        _check_sums(file, header, arrays)
        check_content(header, arrays)
    return FieldContent(header, arrays)


def write_content(
    path: Path, header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]], overwrite: bool
) -> None:
    """Write a ``.scoup`` file, atomically.

    Raises:
        OutputExistsError: the file is there and ``overwrite`` is false.
        WriteError: the system refuses.
    """
    from safetensors import SafetensorError
    from safetensors.numpy import save_file

    # One metadata entry: safetensors writes several in no fixed order, and equal fields must be equal bytes.
    metadata = SealedFile.metadata(header, arrays)
    with atomic_path(path, overwrite) as temporary:
        try:
            temporary.touch()
            permissions = temporary.stat().st_mode  # as of any new file; safetensors makes private ones
            save_file({**arrays}, temporary, metadata)
            temporary.chmod(permissions)
        except OSError as error:
            raise WriteError.of(temporary, error) from error
        except SafetensorError as error:
            # Only the text contains the system's own number: "(os error 28)", or "code: 28" in older versions.
            number = re.search(r"(?:os error|code:) (\d+)", str(error))
            if number is None:
                raise
            code = int(number[1])
            raise WriteError.of(temporary, OSError(code, os.strerror(code))) from error


def write_world(path: Path, world: WorldFrame) -> None:
    """Write a frame of the world into the file of a field; all tensors keep their bytes.

    Raises:
        MissingFileError, FileFormatError, WriteError: the file cannot be read or replaced.
    """
    content = read_content(path)
    left_out = "checksum", "checksums", "frame"
    header = {name: value for name, value in content.header.items() if name not in left_out}
    write_content(path, header | frame_entry(world), content.arrays, overwrite=True)


def frame_entry(world: WorldFrame) -> dict[str, Any]:
    """Return the entry of a frame in the header; nothing for one without anything known."""
    return {} if world == WorldFrame() else {"frame": world.to_dict()}


def _check_sums(file: SealedFile, header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> None:
    """Compare the header and all arrays of a file with their checksums."""
    file.check_header(header["checksum"])
    checksums = header["checksums"]
    if checksums.keys() != arrays.keys():
        raise FileFormatError(file.path, "is damaged (its header names other tensors)", REBUILD)
    for name, array in arrays.items():
        file.check_array(name, array, checksums[name])


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


@contextmanager
def field_damage_named(path: Path) -> Iterator[None]:
    """Turn failures to assemble a field into one FileFormatError that names the file."""
    try:
        yield
    except FileFormatError:
        raise
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError) as error:
        reason = f"lacks {error}" if isinstance(error, KeyError) else str(error)
        raise FileFormatError(path, f"is not a complete language field ({reason})", REBUILD) from error
