"""The files of region sums: arrays with a JSON header in one safetensors file, checked when read, and mapped
into memory (docs/formats.md).
"""

from __future__ import annotations

import hashlib
import json
import math
import re
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from scoup.base import FileFormatError, InputError, atomic_file, refuse_pointer, slug

ENDING = ".safetensors"
SCENE = "scene"  # stem of the file that is not a view

_TYPES = {
    "U8": "uint8", "U16": "uint16", "U32": "uint32", "I32": "int32", "I64": "int64", "F16": "float16", "F32": "float32",
    "F64": "float64",
}  # fmt: skip
_NAMES = {np.dtype(kind): name for name, kind in _TYPES.items()}
_KEY = "scoup"  # of the header in the metadata
_CHECKSUM = re.compile(rb'\\"checksum\\": \\"([0-9a-f]{8})\\"')
NO_CHECKSUM = "0" * 8
_AT_A_TIME = 1 << 24  # bytes read for a checksum
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
    arrays: dict[str, NDArray[Any]]  # read-only; backed by the file, or in memory
    bytes: int  # of the file


def write_arrays(
    path: Path,
    header: Mapping[str, Any],
    arrays: Mapping[str, NDArray[Any]],
    overwrite: bool,
    wait: bool = False,
) -> int:
    """Write a file whole, without flushing it; return its size. Arguments and errors as of ``atomic_file``."""
    # In the order of safetensors: then each begins at a multiple of its item size.
    names = sorted(arrays, key=lambda name: (-arrays[name].dtype.itemsize, name))
    layout, end = {}, 0
    for name in names:
        kind, first, end = _NAMES[arrays[name].dtype], end, end + arrays[name].nbytes
        layout[name] = {"dtype": kind, "shape": list(arrays[name].shape), "data_offsets": [first, end]}
    parts = [np.ascontiguousarray(arrays[name]).reshape(-1).view(np.uint8).data for name in names]
    text = json.dumps({**header, "checksum": NO_CHECKSUM}, sort_keys=True)
    head = json.dumps({"__metadata__": {_KEY: text}, **layout}).encode()
    head += b" " * (-len(head) % 8)
    checksum = zlib.crc32(head)
    for chunk in parts:
        checksum = zlib.crc32(chunk, checksum)
    # Not flushed one by one: the folder is (``RegionSums.flush``), and checksums detect the rest.
    with atomic_file(path, overwrite, flush=False, wait=wait) as stream:
        stream.write(len(head).to_bytes(8, "little"))
        stream.write(with_checksum(head, f"{checksum:08x}"))
        for chunk in parts:
            stream.write(chunk)
    return 8 + len(head) + end


def read_arrays(path: Path, written: bool = False) -> StoredArrays:
    """Read a file, all of it once, to compare its checksum, unless it has just been ``written``; a FileFormatError if
    it is damaged or of another kind."""
    data = _mapped(path)
    length = int.from_bytes(data[:8].tobytes(), "little")
    head = data[8 : 8 + length].tobytes() if length < len(data) else b""
    match = _CHECKSUM.search(head)
    if match is None:
        refuse_pointer(path)
        raise FileFormatError(path, "is not a file of region sums", "check the path")
    checksum = zlib.crc32(with_checksum(head, NO_CHECKSUM))
    for first in range(8 + length, 0 if written else len(data), _AT_A_TIME):
        checksum = zlib.crc32(data[first : first + _AT_A_TIME].data, checksum)
    if not written and f"{checksum:08x}".encode() != match[1]:
        raise FileFormatError(path, "is damaged (checksum)", _REMEDY)
    try:
        layout = json.loads(head)
        header = json.loads(layout.pop("__metadata__")[_KEY])
        arrays = {name: _array(data[8 + length :], **item) for name, item in layout.items()}
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError, RecursionError) as error:
        raise FileFormatError(path, f"is invalid ({error})", "make the region sums again") from error
    return StoredArrays(header, arrays, len(data))


def with_checksum(head: bytes, checksum: str) -> bytes:
    """Return the head of a file with another checksum; checksums are computed with ``NO_CHECKSUM`` in it."""
    return _CHECKSUM.sub(rb'\\"checksum\\": \\"%s\\"' % checksum.encode(), head, count=1)


def _mapped(path: Path) -> NDArray[np.uint8]:
    """Map a file without keeping it open: there may be more views than a process may have open files."""
    try:
        size = path.stat().st_size
        if not size:
            return np.zeros(0, np.uint8)
        return torch.from_file(str(path), False, size, dtype=torch.uint8).numpy()
    except OSError as error:
        raise InputError(str(FileFormatError.unreadable(path, error))) from error
    except RuntimeError as error:  # torch's, for a file that it cannot open
        reason = FileNotFoundError() if not path.exists() else OSError(str(error).splitlines()[0])
        raise InputError(str(FileFormatError.unreadable(path, reason))) from error


def _array(data: NDArray[np.uint8], dtype: str, shape: list[int], data_offsets: list[int]) -> NDArray[Any]:
    """Return one array; a ValueError if it lies outside the file or has another size."""
    kind, (first, end) = np.dtype(_TYPES[dtype]), data_offsets
    if min([first, *shape], default=0) < 0 or not first <= end <= len(data):
        raise ValueError("an array beyond the file")
    if math.prod(shape) * kind.itemsize != end - first or first % kind.itemsize:
        raise ValueError("an array of another size than it says")
    array = data[first:end].view(kind).reshape(shape)
    array.setflags(write=False)
    return array
