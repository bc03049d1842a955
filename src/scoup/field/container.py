"""The container of a language field: safetensors with a JSON header, both with checksums; read without torch."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

from numpy.typing import NDArray

from scoup.base.digests import array_checksum, is_sealed
from scoup.base.errors import FileFormatError, MissingFileError
from scoup.base.safetensors_damage import safetensors_damage_named

SCHEMA = "scoup.language_field"
VERSION = 1
METADATA_KEY = "scoup"
REBUILD = "build the field again, or copy the file again if it was cut short"


def read_container(
    path: Path, framework: Literal["pt", "numpy"]
) -> tuple[str, dict[str, Any], dict[str, Any]]:
    """Return the text of the header, the header, and all tensors of a ``.scoup`` file, not yet checked."""
    from safetensors import safe_open

    what = "a SCOUP language field"
    if not path.is_file():
        raise MissingFileError.of(path, what)
    with safetensors_damage_named(path, what, REBUILD), safe_open(path, framework=framework) as stream:
        metadata = stream.metadata() or {}
        text = metadata.get(METADATA_KEY, "{}")
        header = json.loads(text)
        if not isinstance(header, dict) or header.get("schema") != SCHEMA:
            raise FileFormatError(path, f"is a safetensors file, but not {what}", "check the path")
        return text, header, {name: stream.get_tensor(name) for name in stream.keys()}  # noqa: SIM118


def check_sums(path: Path, text: str, header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> None:
    """Compare the header and all arrays of a file with their checksums."""
    if not is_sealed(text, header["checksum"]):
        raise FileFormatError(path, "is damaged (checksum of the header)", REBUILD)
    checksums = header["checksums"]
    if checksums.keys() != arrays.keys():
        raise FileFormatError(path, "is damaged (its header names other tensors)", REBUILD)
    for name, array in arrays.items():
        if array_checksum(array) != checksums[name]:
            raise FileFormatError(path, f"is damaged (checksum of {name})", REBUILD)


def relative_place(path: Path, target: Path | None) -> str | None:
    """Return the path of a file that another one names, relative to the folder of that one; None for None."""
    if target is None:
        return None
    try:
        return Path(os.path.relpath(target.absolute(), path.absolute().parent)).as_posix()
    except ValueError:  # another drive on Windows
        return target.absolute().as_posix()


def place_of(path: Path, relative: Any) -> Path | None:
    """Return where a file is that another one names relative to its own folder; None for None."""
    return None if relative is None else Path(os.path.normpath(path.absolute().parent / str(relative)))


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
