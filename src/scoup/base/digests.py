"""Checksums of files."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

from scoup.base.errors import MissingFileError, refused_read

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
        raise refused_read(path, error) from error
    return digest.hexdigest()
