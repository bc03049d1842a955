"""Checksums of files and geometry, and archives of arrays with stable bytes."""

from __future__ import annotations

import hashlib
import os
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scoup.base.errors import FileFormatError, MissingFileError
from scoup.base.outputs import atomic_file

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

_BLOCK = 1 << 20  # bytes read at a time


def file_sha256(path: str | Path) -> str:
    """Return the SHA-256 of a file as 64 hexadecimal digits; FileFormatError if the file cannot be read."""
    if not os.path.isfile(path):  # a pipe would be waited for
        raise MissingFileError.of(path, "a file that can be read")
    digest = hashlib.sha256()
    try:
        with open(path, "rb") as stream:
            while block := stream.read(_BLOCK):
                digest.update(block)
    except OSError as error:
        raise FileFormatError.unreadable(path, error) from error
    return digest.hexdigest()


def geometry_fingerprint(
    means: NDArray[Any],  # [N, 3] float32
    quats: NDArray[Any],  # [N, 4] float32
    scales: NDArray[Any],  # [N, 3] float32
    opacities: NDArray[Any],  # [N] float32
) -> str:
    """Return the SHA-256 of the columns that decide all blending weights.

    Colour is left out: a recoloured scene keeps its language field.
    """
    import numpy as np

    digest = hashlib.sha256(f"scoup-geometry-1:{len(means)}".encode())
    for array in (means, quats, scales, opacities):
        digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()


def write_npz(
    path: str | Path, arrays: Mapping[str, np.ndarray], overwrite: bool = False, compressed: bool = False
) -> None:
    """Write arrays by their names, atomically."""
    import numpy as np

    # Not numpy.savez: it stamps the time of writing, and the same arrays should give the same bytes.
    with atomic_file(path, overwrite) as stream, zipfile.ZipFile(stream, "w") as archive:
        for name, array in arrays.items():
            entry = zipfile.ZipInfo(f"{name}.npy")
            entry.compress_type = zipfile.ZIP_DEFLATED if compressed else zipfile.ZIP_STORED
            with archive.open(entry, "w", force_zip64=array.nbytes > 1 << 30) as member:
                np.lib.format.write_array(member, array, allow_pickle=False)
