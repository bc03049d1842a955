"""The rows of a PLY element, as they stand in the file."""

from __future__ import annotations

import warnings

import numpy as np

from scoup.base.errors import FileFormatError
from scoup.io.splats.ply_header import PlyHeader


def read_rows(header: PlyHeader) -> np.ndarray:
    """The rows a header describes: [N] structured."""
    return _read_ascii(header) if header.encoding == "ascii" else _read_binary(header)


def _read_binary(header: PlyHeader) -> np.ndarray:
    try:
        rows = np.fromfile(header.path, dtype=header.dtype, count=header.count, offset=header.offset)
    except OSError as error:
        raise FileFormatError(header.path, f"cannot be read ({error})", "check its permissions") from error
    if len(rows) != header.count:
        raise FileFormatError(header.path, "was cut short while it was read", "copy it again")
    return rows


def _read_ascii(header: PlyHeader) -> np.ndarray:
    rows = np.empty(header.count, dtype=header.dtype)
    if not header.count:
        return rows
    try:
        with open(header.path, "rb") as stream, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # numpy warns of files without data; the shape is checked below
            stream.seek(header.offset)
            values = np.loadtxt(stream, dtype=np.float64, max_rows=header.count, ndmin=2, comments=None)
    except (OSError, ValueError) as error:
        raise FileFormatError(
            header.path, "has lines that are not rows of numbers", "export it again"
        ) from error
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
