""".npy files, opened with their header checked first: a damaged one costs an error, never memory."""

from __future__ import annotations

import ast
import math
import os
import re
from pathlib import Path

import numpy as np

from scoup.base.errors import FileFormatError, refused_read
from scoup.base.existing import existing_file

_MAX_HEADER = 1 << 16
_REMEDY = "the file is cut short or damaged; write it again"


def open_npy(path: str | Path, what: str) -> np.ndarray:
    """Memory-map a .npy file of plain numbers, read only. Nothing but the header is read."""
    path = existing_file(path, what)
    try:
        size = os.path.getsize(path)
        with open(path, "rb") as stream:
            head = stream.read(12 + _MAX_HEADER)
    except OSError as error:
        raise refused_read(path, error) from error
    dtype, shape, column_major, offset = _parse(path, head)
    needed = offset + math.prod(shape) * dtype.itemsize
    if needed > size:
        raise FileFormatError(path, f"is cut short: {size} bytes, its header says {needed}", _REMEDY)
    order = "F" if column_major else "C"
    if 0 in shape:
        return np.zeros(shape, dtype=dtype, order=order)
    try:
        return np.memmap(path, dtype=dtype, mode="r", offset=offset, shape=shape, order=order)
    except FileNotFoundError as error:
        raise refused_read(path, error) from error
    except (OSError, ValueError, OverflowError) as error:
        raise FileFormatError(path, f"cannot be mapped ({error})", _REMEDY) from error


def _parse(path: Path, head: bytes) -> tuple[np.dtype, tuple[int, ...], bool, int]:
    if head[:6] != b"\x93NUMPY" or len(head) < 12:
        problem = "is empty" if not head else "is not a .npy file"
        raise FileFormatError(path, problem, _REMEDY)
    wide = head[6] >= 2
    start = 12 if wide else 10
    length = int.from_bytes(head[8:start], "little")
    text = head[start : start + length]
    if len(text) < length:
        raise FileFormatError(path, "has no complete header", _REMEDY)
    try:
        header = ast.literal_eval(text.decode("latin-1").strip())
        descr, shape, column_major = header["descr"], header["shape"], header["fortran_order"]
    except (ValueError, SyntaxError, TypeError, KeyError, MemoryError, RecursionError) as error:
        raise FileFormatError(path, "has a damaged header", _REMEDY) from error
    if not isinstance(descr, str) or not re.fullmatch(r"[<>|=]?([iu][1248]|f[248])", descr):
        raise FileFormatError(path, f"does not contain plain numbers (type {str(descr)[:40]!r})", _REMEDY)
    sound = isinstance(shape, tuple) and len(shape) <= 8
    if not sound or not all(isinstance(side, int) and 0 <= side < 1 << 48 for side in shape):
        raise FileFormatError(path, "has a damaged shape in its header", _REMEDY)
    return np.dtype(descr), shape, bool(column_major), start + length
