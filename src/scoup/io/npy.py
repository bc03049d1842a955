""".npy files of plain numbers, mapped into memory: a damaged one costs an error, never memory."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from scoup.base import FileFormatError, existing_file

_MOST_OF_HEADER = 1 << 16  # bytes; numpy takes fewer
_REMEDY = "the file is cut short or damaged; write it again"


def open_npy(path: str | Path, what: str) -> np.ndarray:
    """Memory-map a .npy file of plain numbers, read only. Nothing but the header is read."""
    path = existing_file(path, what)
    try:
        with open(path, "rb") as stream:
            head = stream.read(12)
        if head[6:7] > b"\1" and int.from_bytes(head[8:], "little") > _MOST_OF_HEADER:
            raise ValueError("too long a header")  # numpy would take that much memory before it reads
        array = np.lib.format.open_memmap(path, mode="r")
    except OSError as error:
        raise FileFormatError.unreadable(path, error) from error
    except Exception as error:  # damaged headers raise nearly everything inside numpy
        reason = (str(error).splitlines() or [type(error).__name__])[0][:200]  # numpy repeats the header
        problem = f"is not a .npy file of plain numbers, or is damaged ({reason})"
        raise FileFormatError(path, problem, _REMEDY) from error
    if array.dtype.kind not in "iuf":
        raise FileFormatError(path, f"does not contain plain numbers (type {array.dtype})", _REMEDY)
    return array
