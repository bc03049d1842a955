"""Checksums of files, arrays and headers, and archives of arrays with stable bytes."""

from __future__ import annotations

import hashlib
import json
import os
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scoup.base.errors import FileFormatError, MissingFileError
from scoup.base.outputs import atomic_file

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

_BLOCK = 1 << 20  # bytes read at a time
NO_CHECKSUM = "0" * 8


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


def array_checksum(array: NDArray[Any]) -> str:
    """Return the CRC-32 over type, shape and bytes of an array, as eight hexadecimal digits.

    CRC-32 finds every error of a few bits, and is the fastest checksum of the standard library.
    """
    import numpy as np

    described = f"{array.dtype} {list(array.shape)}\n".encode()
    content = np.ascontiguousarray(array).reshape(-1).view(np.uint8).data
    return f"{zlib.crc32(content, zlib.crc32(described)):08x}"


def sealed(header: Mapping[str, Any]) -> str:
    """Return a header as JSON, with a checksum of this very text, taken with zeros in the checksum's place."""
    text = json.dumps({**header, "checksum": NO_CHECKSUM}, sort_keys=True)
    return _replaced(text, NO_CHECKSUM, _crc32(text))


def is_sealed(text: str, checksum: object) -> bool:
    """Return whether the checksum in the text of a header is right."""
    return isinstance(checksum, str) and _crc32(_replaced(text, checksum, NO_CHECKSUM)) == checksum


def _crc32(text: str) -> str:
    return f"{zlib.crc32(text.encode()):08x}"


def _replaced(text: str, checksum: str, other: str) -> str:
    return text.replace(f'"checksum": "{checksum}"', f'"checksum": "{other}"', 1)


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
