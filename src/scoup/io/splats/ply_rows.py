"""The rows of a PLY element, as they are in the file."""

from __future__ import annotations

import re
import warnings
from codecs import BOM_UTF8
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import Any

import numpy as np
import torch

from scoup.base import FileFormatError, scratch_array
from scoup.io.reading import read_bytes
from scoup.io.splats.activation import finite_rows, warn_of_dropped
from scoup.io.splats.ply_header import PlyHeader
from scoup.scene import Gaussians

AT_A_TIME = 1 << 18  # rows of a large file
_MICROSOFT = {rb"-?nan\(\w*\)|-?1\.#(ind|qnan|snan)\d*": b"nan", rb"1\.#inf\d*": b"inf"}


def read_rows(header: PlyHeader) -> np.ndarray:
    """Return the rows a header describes: [N] structured, little endian."""
    return _read_ascii(header) if header.encoding == "ascii" else _read_binary(header, 0, header.count)


def read_large(header: PlyHeader, activate: Callable[[np.ndarray], dict[str, np.ndarray]]) -> Gaussians:
    """Read the Gaussians of the rows that a binary header describes, read in parts, with all values in temporary files.
    ``activate`` returns the values [M, ...] of some rows, by the names of ``Gaussians``."""
    arrays: dict[str, np.ndarray] = {}
    count, kept = 0, []
    for first in range(0, header.count, AT_A_TIME):
        block = activate(_read_binary(header, first, min(AT_A_TIME, header.count - first)))
        finite = finite_rows(list(block.values()))
        kept.append(finite)
        end = count + int(finite.sum())
        for name, values in block.items():
            if name not in arrays:
                arrays[name] = scratch_array((header.count, *values.shape[1:]), np.float32)
            arrays[name][count:end] = values[finite]
        count = end
    if count < header.count:
        warn_of_dropped(header.count - count, header.count, str(header.path), stacklevel=4)
    tensors: dict[str, Any] = {name: torch.from_numpy(values[:count]) for name, values in arrays.items()}
    rows = torch.from_numpy(np.concatenate(kept)) if count < header.count else None
    return Gaussians(**tensors, source_rows=rows)


def _read_binary(header: PlyHeader, first: int, count: int) -> np.ndarray:
    offset = header.offset + first * header.dtype.itemsize
    try:
        rows = np.fromfile(header.path, dtype=header.dtype, count=count, offset=offset)
    except OSError as error:
        raise FileFormatError.unreadable(header.path, error) from error
    if len(rows) != count:
        raise FileFormatError(header.path, "was truncated while being read", "copy it again")
    return rows.astype(header.dtype.newbyteorder("<"), copy=False)


def _read_ascii(header: PlyHeader) -> np.ndarray:
    rows = np.empty(header.count, dtype=header.dtype)
    if not header.count:
        return rows
    try:
        with open(header.path, "rb") as stream:
            stream.seek(header.offset)
            values = _numbers(stream, header.count)
    except OSError as error:
        raise FileFormatError.unreadable(header.path, error) from error
    except ValueError:
        values = _foreign_numbers(header)
    if values.shape != (header.count, len(header.dtype.names or ())):
        raise FileFormatError(
            header.path,
            f"has {values.shape[0]} rows of {values.shape[1]} numbers, but its header says"
            f" {header.count} of {len(header.dtype.names or ())}",
            "the file is cut short or damaged; copy it again",
        )
    with np.errstate(all="ignore"):
        for column, name in enumerate(header.dtype.names or ()):
            rows[name] = values[:, column]
    return rows


def _numbers(lines: Iterable[bytes], count: int) -> np.ndarray:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # numpy warns of files without data; the shape is checked later
        return np.loadtxt(lines, dtype=np.float64, max_rows=count, ndmin=2, comments=None)


def _foreign_numbers(header: PlyHeader) -> np.ndarray:
    """Return rows that follow a byte order mark, or have NaN and infinity as Microsoft's compiler writes them."""
    content = read_bytes(header.path)[header.offset :].removeprefix(BOM_UTF8)
    for written, number in _MICROSOFT.items():
        content = re.sub(written, number, content, flags=re.IGNORECASE)
    lines = content.splitlines()
    try:
        return _numbers(lines, header.count)
    except ValueError:
        words = ((row, word) for row, line in enumerate(lines, start=1) for word in line.split())
        problem = "has rows of different lengths"
        for row, word in words:
            if not _is_number(word):
                shown = word[:40].decode("utf-8", "replace")
                problem = f"has {shown!r} in place of a number (row {row})"
                break
        raise FileFormatError(header.path, problem, "export it again") from None


def _is_number(word: bytes) -> bool:
    with suppress(ValueError):
        float(word)
        return True
    return False
