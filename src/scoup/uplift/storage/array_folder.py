"""Arrays with JSON headers by name, kept in memory or in a folder with one file per name."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scoup.base.errors import FileFormatError, InputError, WriteError
from scoup.uplift.storage.array_file import StoredArrays, read_arrays, write_arrays
from scoup.uplift.storage.paths import ENDING, SCENE

Arrays = Mapping[str, NDArray[Any]]


class ArrayFolder(ABC):
    """The contents of a folder, which is made with the first name that is written; ``path`` is None in memory."""

    def __init__(self, path: Path | None) -> None:
        self.path = path
        self.writable = True
        self._bytes: dict[str, int] = {}  # of each file

    @property
    def bytes(self) -> int:
        """Size in memory or on disk."""
        return sum(self._bytes.values())

    @abstractmethod
    def _scene(self) -> tuple[dict[str, Any], Arrays]:
        """Header and arrays of the file that is written first."""

    @abstractmethod
    def _apply(self, stem: str, stored: StoredArrays) -> None:
        """Use the contents of a file."""

    def _write(self, stem: str, header: dict[str, Any], arrays: Arrays) -> None:
        """Write a file and use it from there, or keep its contents in memory."""
        self._check_writable()
        if self.path is None:
            kept = {name: np.array(array) for name, array in arrays.items()}
            self._apply(stem, StoredArrays(header, kept, sum(array.nbytes for array in kept.values())))
            return
        if not self._bytes:
            try:
                self.path.mkdir(parents=True)
            except OSError as error:
                raise WriteError.of(self.path, error) from error
            self._bytes[SCENE] = write_arrays(self.path / f"{SCENE}{ENDING}", *self._scene())
        file = self.path / f"{stem}{ENDING}"
        write_arrays(file, header, arrays)
        self._load(file)

    def _load(self, file: Path) -> None:
        stored = read_arrays(file)
        with report_damage(file):
            self._apply(file.name.removesuffix(ENDING), stored)

    def _unlink(self, stem: str) -> None:
        self._check_writable()
        if self.path is not None:
            file = self.path / f"{stem}{ENDING}"
            try:
                file.unlink()
            except OSError as error:
                raise WriteError.of(file, error) from error
        del self._bytes[stem]

    def _check_writable(self) -> None:
        if not self.writable:
            raise InputError(f"{self.path or 'region sums of several folders'}: opened for reading only")


@contextmanager
def report_damage(file: Path) -> Iterator[None]:
    """Turn failures to interpret a file into a FileFormatError that names it."""
    try:
        yield
    except (KeyError, TypeError, ValueError, OverflowError, AttributeError) as error:
        if isinstance(error, (FileFormatError, WriteError)):
            raise
        reason = f"lacks {error}" if isinstance(error, KeyError) else str(error)
        raise FileFormatError(file, f"is invalid ({reason})", "make the region sums again") from error
