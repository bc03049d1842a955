"""The scans of an archive in memory, and their vectors: a matrix [rows, D] of float16 in one file.

Writers hold the lock of the matrix. They write the vectors of a scan to free rows, then its Parquet file, which names
these rows. So a killed writer leaves free rows. Readers hold no lock: they ask again if a scan that answers has changed
meanwhile.
"""

from __future__ import annotations

import io
import os
import stat
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, TypeAlias, TypeVar

import numpy as np
import torch
from torch import Tensor

from scoup.archive.scan_files import Scan, read_scans
from scoup.archive.scan_header import ENDING, file_of, scan_names
from scoup.base import FileFormatError, MissingFileError, WriteError, existing_file, locked
from scoup.query import ThingIndex

if TYPE_CHECKING:
    from duckdb import DuckDBPyConnection

MATRIX = "vectors.f16"
MOST_TRIED = 3  # attempts that require all scans to be unchanged
Stamp: TypeAlias = "tuple[int, int]"
"""Time and size of a file."""
Found = TypeVar("Found")
_REMEDY = "add the field of this scan again, or remove it"  # of what the matrix lacks


def vector_bytes(vectors: Tensor) -> bytes:
    """Return vectors [T, D] as the matrix has them."""
    return vectors.cpu().half().numpy().astype("<f2").tobytes()


class KeptScans:
    """A cache of the scans of an archive; files that have not changed are read once."""

    def __init__(self, folder: Path, connection: Callable[[], DuckDBPyConnection]) -> None:
        self._folder, self._connection = folder, connection
        self._lock = Lock()  # of the attributes below
        self._scans: dict[str, tuple[Stamp, Scan]] = {}
        self._parts: dict[Scan, ThingIndex] = {}
        self._index: ThingIndex | None = None  # of these parts
        self._digest = ""  # of their words

    def ask(
        self,
        use: Callable[[dict[str, Scan]], Found],
        used: Callable[[Found], Iterable[str]] = lambda result: (),
    ) -> Found:
        """Return ``use(scans)`` of the present scans, by name; again if ``used`` ones have changed meanwhile, or ones
        that an error may be about; the first few times if any has, as another scan may have its rows now."""
        tried = 0
        while True:
            tried += 1
            stamps = self._listed()
            try:
                result = use(self._read(stamps))
                if not self._changed(stamps, used(result) if tried > MOST_TRIED else stamps):
                    return result
            except Exception as error:  # DuckDB has its own
                path = getattr(error, "path", None)
                named = [name for name in stamps if file_of(self._folder, name) == path]
                if not self._changed(stamps, named or stamps):
                    raise

    def index(self, scans: Mapping[str, Scan], words: Tensor, digest: str) -> ThingIndex:
        """Return the things of scans, one at least, compared with words of a digest, or with whatever they were
        compared with; it is kept until they change."""
        with self._lock:
            if digest and digest != self._digest:
                self._parts, self._digest = {}, digest
            if self._index is None or [*scans.values()] != [*self._parts]:
                new = [scan for scan in scans.values() if scan not in self._parts]
                parts = self._parts | dict(zip(new, self._compared(new, words), strict=True))
                self._parts = {scan: parts[scan] for scan in scans.values()}
                self._index = ThingIndex.joined([*self._parts.values()])
            return self._index

    @contextmanager
    def writing(self) -> Iterator[dict[str, Scan]]:
        """Keep others from writing until the block ends, and yield the scans, without damaged ones."""
        with locked(self._folder / MATRIX, wait=True):
            stamps, scans = self._listed(), None
            while scans is None:
                try:
                    scans = self._read(stamps)
                except FileFormatError as error:
                    if stamps.pop(error.path.stem, None) is None:
                        raise
            yield scans

    def write_vectors(self, vectors: bytes, row: int, dim: int) -> None:
        """Write vectors to the matrix from a row on."""
        path = self._folder / MATRIX
        try:
            with suppress(FileExistsError):
                path.touch(exist_ok=False)
            with path.open("r+b") as stream:
                stream.seek(2 * dim * row)
                stream.write(vectors)
                stream.flush()
                os.fsync(stream.fileno())
        except OSError as error:
            raise WriteError.of(path, error) from error

    def _listed(self) -> dict[str, Stamp]:
        stamps: dict[str, Stamp] = {}
        for name in scan_names(self._folder):
            try:
                state = os.stat(file := f"{self._folder}/{name}{ENDING}")
            except FileNotFoundError:  # removed meanwhile
                continue
            if not stat.S_ISREG(state.st_mode):  # whoever opens a pipe waits for its writer
                raise MissingFileError.of(file, "a scan of an archive", "move it")
            stamps[name] = state.st_mtime_ns, state.st_size
        return stamps

    def _changed(self, stamps: Mapping[str, Stamp], names: Iterable[str]) -> bool:
        now = self._listed()
        return any(stamps[name] != now.get(name) for name in names)

    def _read(self, stamps: Mapping[str, Stamp]) -> dict[str, Scan]:
        with self._lock:
            known = {name: self._scans[name] for name in stamps if name in self._scans}
            new = [name for name, stamp in stamps.items() if name not in known or known[name][0] != stamp]
            read = read_scans([file_of(self._folder, name) for name in new], self._connection())
            known |= {name: (stamps[name], scan) for name, scan in zip(new, read, strict=True)}
            self._scans = known
            return {name: known[name][1] for name in stamps}

    def _compared(self, scans: Sequence[Scan], words: Tensor) -> Iterator[ThingIndex]:
        if not scans:
            return
        expected = f"a matrix with the vectors of the scan {scans[0].name}"
        path = existing_file(self._folder / MATRIX, expected, _REMEDY)
        try:
            with path.open("rb") as stream:
                for scan in scans:
                    vectors = _vectors(path, stream, scan, words.shape[1])
                    yield scan.index(vectors, words, self._digest)
        except OSError as error:
            raise FileFormatError.unreadable(path, error) from error


def _vectors(path: Path, stream: io.BufferedReader, scan: Scan, dim: int) -> Tensor:
    """Return the vectors [T, dim] of a scan, in memory: mapped ones would end the process if the file is cut."""
    rows = np.empty((len(scan), dim), "<f2")
    end = os.fstat(stream.fileno()).st_size  # a damaged row may be too large for seek
    stream.seek(min(scan.row * dim * rows.itemsize, end))
    size = stream.readinto(rows.data.cast("B"))
    if size < rows.nbytes or zlib.crc32(rows.data) != scan.vectors_checksum:
        raise FileFormatError(path, f"is damaged in the vectors of the scan {scan.name}", _REMEDY)
    vectors = torch.from_numpy(rows)
    if not vectors.isfinite().all():
        problem = f"contains values that are not finite, in the vectors of the scan {scan.name}"
        raise FileFormatError(path, problem, _REMEDY)
    return vectors


def free_row(scans: Iterable[Scan], count: int) -> int:
    """Return the first of ``count`` rows of the matrix that no scan has."""
    row = 0
    for scan in sorted(scans, key=lambda scan: scan.row):
        if scan.row - row >= count:
            break
        row = max(row, scan.row + len(scan))
    return row
