"""The scans of an archive in memory, and in a file beside them."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, TypeAlias, TypeVar

from scoup.archive.read_scans import ScanBlock, read_block, read_records
from scoup.archive.scan_files import ScanRecord, header_of, record_of
from scoup.base.errors import FileFormatError, ScoupError
from scoup.uplift.storage.array_file import read_arrays, write_arrays

if TYPE_CHECKING:
    from duckdb import DuckDBPyConnection

ENDING, KEPT, VERSION = ".parquet", ".scans.safetensors", 1
LEAST_KEPT, SHARE_KEPT = 10_000, 1 / 8
"""The file is written again once at least so many things, and this share of all, differ from those in it."""
SCANS_KEPT = 128  # with all that was computed of them
Stamp: TypeAlias = "tuple[int, int]"
"""Time and size of a file."""
Place: TypeAlias = "tuple[ScanBlock, int]"
"""A scan: its block, and its number there."""
Found = TypeVar("Found")


def scan_names(folder: Path) -> list[str]:
    """Return the names of the scans in a folder, in order."""
    names = os.listdir(folder) if folder.is_dir() else []
    return sorted(name[: -len(ENDING)] for name in names if name.endswith(ENDING) and name[0] != ".")


def file_of(folder: Path, name: str) -> Path:
    """Return the file of a scan."""
    return folder / f"{name}{ENDING}"


class KeptScans:
    """What was read of the scans of an archive; files that have not changed are read once.

    Reading many Parquet files takes long. So what was read of many is written to a file beside them, too, and used as
    long as names, times and sizes of theirs are the same. It may be removed at any time.

    Args:
        folder: of the archive.
        connection: returns a connection to DuckDB.
        check: refuses records.
    """

    def __init__(
        self,
        folder: Path,
        connection: Callable[[], DuckDBPyConnection],
        check: Callable[[Sequence[ScanRecord]], None],
    ) -> None:
        self._folder, self._connection, self._check = folder, connection, check
        self._lock = Lock()  # of all that follow
        self._stamps: dict[str, Stamp] = {}
        self._places: dict[str, Place] = {}
        self._stored: ScanBlock | None = None  # what the file contains
        self.scan = lru_cache(SCANS_KEPT)(ScanBlock.scan)

    def records(self, names: Iterable[str]) -> list[ScanRecord]:
        """Read the metadata of scans, and check them."""
        records = read_records([file_of(self._folder, name) for name in names], self._connection())
        self._check(records)
        return records

    def places(self) -> dict[str, Place]:
        """Return the scans as they are now, by name."""
        with self._lock:
            return self.read_now(self._updated)

    def places_where(
        self, matching: Callable[[Iterable[str]], dict[str, set[int]]]
    ) -> dict[str, tuple[Place, set[int]]]:
        """Return the scans with things for which a condition holds, and these things, both of the same files.

        Args:
            matching: returns the things of files, by scan; scans without any are left out.
        """
        chosen: dict[str, tuple[Place, set[int]]] = {}
        changed: set[str] | None = None
        while changed is None or changed:
            with self._lock:
                places, stamps = self.read_now(self._updated), self._stamps
            names = {*places} if changed is None else changed & {*places}
            found = self.read_now(lambda now, names=names: matching(sorted(names & {*now})))
            now = self._listed()
            changed = {name for name in found if now.get(name) != stamps[name]}
            chosen |= {name: (places[name], found[name]) for name in {*found} - changed}
        return dict(sorted(chosen.items()))

    def read_now(self, read: Callable[[dict[str, Stamp]], Found]) -> Found:
        """Return ``read(stamps)`` of the scans as they are now; again if it failed and they have changed.

        Where the error names a scan, that one must have changed: others may be added all the time.
        """
        while True:
            stamps = self._listed()
            try:
                return read(stamps)
            except Exception as error:  # DuckDB has its own
                now = self._listed()
                names = {error.path.stem} if isinstance(error, FileFormatError) else {*stamps, *now}
                if all(stamps.get(name) == now.get(name) for name in names):
                    raise

    def _listed(self) -> dict[str, Stamp]:
        stamps: dict[str, Stamp] = {}
        for name in scan_names(self._folder):
            with suppress(FileNotFoundError):  # removed meanwhile
                state = os.stat(f"{self._folder}/{name}{ENDING}")
                stamps[name] = state.st_mtime_ns, state.st_size
        return stamps

    def _updated(self, stamps: dict[str, Stamp]) -> dict[str, Place]:
        if not self._stamps:
            self._read()
        if stamps != self._stamps:
            new = [name for name, stamp in stamps.items() if stamp != self._stamps.get(name)]
            places = self._places
            if new:
                block = read_block(self.records(new), self._connection())
                places = places | {name: (block, number) for number, name in enumerate(new)}
            self._places = self._written(stamps, {name: places[name] for name in stamps})
            self._stamps = stamps
            self.scan.cache_clear()  # it has the old blocks
        return self._places

    def _read(self) -> None:
        with suppress(ScoupError, AttributeError, LookupError, TypeError, ValueError):
            stored = read_arrays(self._folder / KEPT)
            if stored.header["version"] != VERSION:
                return
            scans = stored.header["scans"]
            records = tuple(record_of(file_of(self._folder, name), header) for name, _, header in scans)
            self._check(records)
            for array in stored.arrays.values():
                array.setflags(write=True)  # torch warns of others; what it changes is not in the file
            self._stored = block = ScanBlock(records, stored.arrays)
            self._places = {name: (block, number) for number, (name, _, _) in enumerate(scans)}
            self._stamps = {name: (time, size) for name, (time, size), _ in scans}

    def _written(self, stamps: dict[str, Stamp], places: dict[str, Place]) -> dict[str, Place]:
        """Return scans, which are written if many differ from those in the file, as one block then."""
        sizes = [(block, block.records[number].n_things) for block, number in places.values()]
        same = sum(size for block, size in sizes if block is self._stored)
        stored = 0 if self._stored is None else self._stored.starts[-1]
        total = sum(size for _, size in sizes)
        if not total or total + stored - 2 * same < max(LEAST_KEPT, SHARE_KEPT * total):
            return places
        self._stored = block = ScanBlock.joined([*places.values()])
        headers = map(header_of, block.records)
        header = {"version": VERSION, "scans": [*zip(stamps, stamps.values(), headers, strict=True)]}
        with suppress(ScoupError):  # a folder that is only read
            write_arrays(self._folder / KEPT, header, block.columns, overwrite=True)
        return {name: (block, number) for number, name in enumerate(places)}
