"""Temporary files without a name, and large arrays in them, whose memory the system can take back."""

from __future__ import annotations

import math
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scoup.base.errors import WriteError

if TYPE_CHECKING:
    from numpy.typing import DTypeLike, NDArray

MOST_ROWS_IN_MEMORY = 8_000_000
"""Gaussians up to which everything about a scene is kept in memory; of more, most of it is in temporary files."""


@contextmanager
def temporary_folder() -> Iterator[Path]:
    """Yield a new folder in the system's folder for such (TMPDIR); gone at the end of the block."""
    try:
        folder = Path(tempfile.mkdtemp(prefix="scoup-"))
    except OSError as error:
        raise refused_temporary(error) from error
    try:
        yield folder
    except WriteError as error:
        if not Path(error.path).is_relative_to(folder):
            raise
        raise refused_temporary(OSError(error.reason)) from error
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def scratch_array(shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
    """Return zeros in a temporary file without a name (in TMPDIR) that is mapped into memory; the file disappears with
    the array."""
    import numpy as np

    size = math.prod(shape) * np.dtype(dtype).itemsize
    if not size:
        return np.zeros(shape, dtype)
    try:
        with tempfile.TemporaryFile(prefix="scoup-", buffering=0) as stream:
            # Allocate the space now: writing into a mapping on a full disk kills the process.
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(stream.fileno(), 0, size)
            else:
                stream.truncate(size)
            return np.asarray(np.memmap(stream, dtype, "r+", shape=shape))
    except OSError as error:
        raise refused_temporary(error) from error


def refused_temporary(error: OSError) -> WriteError:
    # tempdir is None where no folder was found that can be used.
    where = f" in {tempfile.tempdir}" if tempfile.tempdir else ""
    remedy = "set the environment variable TMPDIR to a folder with more space"
    return WriteError(f"temporary file{where}", error.strerror or str(error), remedy)
