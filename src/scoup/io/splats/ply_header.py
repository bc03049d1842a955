"""The header of a PLY file: position and type of its vertices (or another element)."""

from __future__ import annotations

import os
import re
import warnings
from codecs import BOM_UTF8
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from scoup.base import FileFormatError, InputError, ScoupWarning, counted, existing_file
from scoup.io.splats.activation import SH_BASES

MAX_HEADER_BYTES = 1 << 16
MAX_PROPERTIES = 4096
_DAMAGED = "the file is damaged; copy or export it again"

MIP = "SplatRenderMode: mip"
"""A comment in PLY files of splats that were trained with antialiasing, as Brush, gsplat and nerfstudio write it."""

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip
_NAMES = {kind: name for name, kind in reversed(_TYPES.items())}  # the first, and oldest, name of each
_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": "<"}


@dataclass(frozen=True)
class PlyHeader:
    """The header of one element, most often the vertices."""

    path: Path
    encoding: str  # "binary_little_endian", "binary_big_endian" or "ascii"
    count: int  # number of rows; checked against the size of the file
    dtype: np.dtype  # structured type of one row in the file's byte order
    offset: int  # where the rows start, in bytes (always the first element of an ASCII file)
    comments: tuple[str, ...]  # comment lines, without the keyword
    elements: tuple[str, ...]  # names of all elements of the file


@dataclass
class _Element:
    name: str
    count: int
    fields: list[tuple[str, str]]
    lists: list[str]


def read_header(path: str | Path, element: str = "vertex") -> PlyHeader:
    """Read the header and check it against the size of the file; takes no memory for the rows."""
    path = existing_file(path, "a PLY file")
    try:
        size = os.path.getsize(path)
        with open(path, "rb") as stream:
            head = stream.read(MAX_HEADER_BYTES)
    except OSError as error:
        raise FileFormatError.unreadable(path, error) from error
    lines, body = _header_lines(path, head)
    encoding, elements, comments = _parse(path, lines)
    names = tuple(item.name for item in elements)
    if element not in names:
        raise FileFormatError(path, f"has no element {element!r}", "use the PLY of a trained splat")
    wanted = elements[names.index(element)]
    if wanted.lists:
        problem = f"has a list property ({wanted.lists[0]}) in element {element!r}"
        raise FileFormatError(path, problem, "export it without")
    dtype = _dtype(path, wanted, encoding)
    offset = body + _bytes_before(path, elements[: names.index(element)], encoding)
    _check_size(path, wanted, dtype, size - offset, encoding, last=elements[-1] is wanted)
    return PlyHeader(path, encoding, wanted.count, dtype, offset, comments, names)


def rest_names(names: Sequence[str]) -> tuple[str, ...] | None:
    """Return the properties f_rest_0 onwards; None if there are others of the kind, or they make no whole SH degree."""
    count = sum(name.startswith("f_rest_") for name in names)
    ordered = tuple(f"f_rest_{number}" for number in range(count))
    return ordered if count in {3 * (bases - 1) for bases in SH_BASES} and {*ordered} <= {*names} else None


def ply_type(dtype: np.dtype) -> np.dtype:
    """Return ``dtype`` if PLY has such a number, else the nearest that it has."""
    if dtype.kind not in "biuf":
        raise InputError(f"a PLY property cannot hold values of type {dtype}")
    if dtype.str[1:] in _NAMES:
        return dtype
    return np.dtype({"b": "u1", "i": "i4", "u": "u4"}.get(dtype.kind, "f4"))


def format_header(dtype: np.dtype, count: int, comments: tuple[str, ...] = ()) -> bytes:
    """Return the header of a file with ``count`` vertices of the structured type ``dtype``, little endian."""
    names = dtype.names or ()
    lines = ["ply", "format binary_little_endian 1.0"]
    lines += [f"comment {comment}" for comment in comments]
    lines.append(f"element vertex {count}")
    lines += [f"property {_NAMES[dtype[name].str[1:]]} {name}" for name in names]
    return "\n".join([*lines, "end_header", ""]).encode()


def _header_lines(path: Path, head: bytes) -> tuple[list[bytes], int]:
    mark = len(BOM_UTF8) if head.startswith(BOM_UTF8) else 0
    head = head[mark:]
    if not head.startswith((b"ply\n", b"ply\r\n")):
        problem = "is empty" if not head else "is not a PLY file (it does not start with 'ply')"
        raise FileFormatError(path, problem, "copy or export it again")
    end = head.find(b"\nend_header")
    newline = head.find(b"\n", end + 1) if end >= 0 else -1
    if newline < 0 or head[end + 1 : newline].strip() != b"end_header":
        raise FileFormatError(path, "has no complete PLY header (no end_header)", _DAMAGED)
    return head[:end].split(b"\n"), mark + newline + 1


def _parse(path: Path, lines: list[bytes]) -> tuple[str, list[_Element], tuple[str, ...]]:
    encoding = ""
    elements: list[_Element] = []
    comments: list[str] = []
    for line in lines[1:]:
        # As bytes: text in UTF-8 contains bytes that are line ends and spaces in Latin-1.
        words = [_text(word) for word in line.split()]
        match words:
            case [] | ["obj_info", *_]:
                pass
            case ["comment", *_]:
                comments.append(_text(line.split(b"comment", 1)[1].strip()))
            case ["format", kind, _] if kind in _ORDERS:
                encoding = kind
            case ["element", name, count] if count.isascii() and count.isdigit() and len(count) < 19:
                elements.append(_Element(name, int(count), [], []))
            case ["property", "list", _, _, name] if elements:
                elements[-1].lists.append(name)
            case ["property", kind, name] if elements and kind in _TYPES:
                elements[-1].fields.append((name, _TYPES[kind]))
            case _:
                shown = line[:60].decode("utf-8", "replace")
                raise FileFormatError(path, f"has the header line {shown!r}", _DAMAGED)
    if not encoding:
        raise FileFormatError(path, "does not name its format in the header", _DAMAGED)
    return encoding, elements, tuple(comments)


def _text(data: bytes) -> str:
    """Decode UTF-8, as ``format_header`` writes it, or else Latin-1, as some other programs do."""
    try:
        return data.decode()
    except UnicodeDecodeError:
        return data.decode("latin-1")


def _dtype(path: Path, element: _Element, encoding: str) -> np.dtype:
    names = [re.sub(r"^(scalar_)+", "", name) for name, _ in element.fields]  # CloudCompare's prefix
    if len(set(names)) != len(names):
        names = [name for name, _ in element.fields]
    if not names or len(set(names)) != len(names) or len(names) > MAX_PROPERTIES:
        problem = f"has no, twice the same, or too many properties in element {element.name!r}"
        raise FileFormatError(path, problem, _DAMAGED)
    kinds = [_ORDERS[encoding] + kind for _, kind in element.fields]
    return np.dtype([*zip(names, kinds, strict=True)])


def _bytes_before(path: Path, elements: list[_Element], encoding: str) -> int:
    """Return the size of the elements before the one requested."""
    total = 0
    for element in elements:
        if element.count and (element.lists or encoding == "ascii"):
            problem = f"has element {element.name!r} before its vertices"
            raise FileFormatError(path, problem, "export it with vertices first")
        if element.count:
            total += element.count * _dtype(path, element, encoding).itemsize
    return total


def _check_size(
    path: Path, element: _Element, dtype: np.dtype, available: int, encoding: str, last: bool
) -> None:
    count = element.count
    # In ASCII every value takes at least a digit and a separator (the last one may lack it).
    needed = count * dtype.itemsize if encoding != "ascii" else 2 * count * len(dtype.names or ()) - 1
    if needed > available:
        fits = max(available, 0) // max(dtype.itemsize, 1)
        raise FileFormatError(
            path,
            f"is cut short: its header says {count} rows of {element.name!r}, there is room for {fits}",
            "copy or download it again",
        )
    if needed < available and encoding != "ascii" and last:
        warnings.warn(
            f"{path}: has {counted(available - needed, 'byte')} more than its header says, which were not read",
            ScoupWarning,
            stacklevel=4,
        )
