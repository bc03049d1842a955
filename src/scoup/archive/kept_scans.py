"""The scans of an archive in memory, and in a file beside them."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from scoup.archive.read_scans import ScanBlock, read_block, read_records
from scoup.archive.scan_files import ScanRecord, header_of, record_of
from scoup.base.errors import ScoupError
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
        self._stamps: dict[str, Stamp] = {}
        self._places: dict[str, Place] = {}
        self._stored: ScanBlock | None = None  # what the file contains
        self.scan = lru_cache(SCANS_KEPT)(ScanBlock.scan)

    def records(self, names: Sequence[str]) -> list[ScanRecord]:
        """Read the metadata of scans, and check them."""
        records = read_records([file_of(self._folder, name) for name in names], self._connection())
        self._check(records)
        return records

    def places(self) -> dict[str, Place]:
        """Return the scans as they are now, by name."""
        stamps: dict[str, Stamp] = {}
        for name in scan_names(self._folder):
            with suppress(FileNotFoundError):  # removed meanwhile
                state = os.stat(f"{self._folder}/{name}{ENDING}")
                stamps[name] = state.st_mtime_ns, state.st_size
        if not self._stamps:
            self._read()
        if stamps != self._stamps:
            new = [name for name, stamp in stamps.items() if stamp != self._stamps.get(name)]
            places = self._places
            if new:
                block = read_block(self.records(new), self._connection())
                places = places | {name: (block, number) for number, name in enumerate(new)}
            self._stamps, self._places = stamps, {name: places[name] for name in stamps}
            self.scan.cache_clear()  # it has the old blocks
            self._write()
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

    def _write(self) -> None:
        sizes = [(block, block.records[number].n_things) for block, number in self._places.values()]
        same = sum(size for block, size in sizes if block is self._stored)
        stored = 0 if self._stored is None else self._stored.starts[-1]
        total = sum(size for _, size in sizes)
        if not total or total + stored - 2 * same < max(LEAST_KEPT, SHARE_KEPT * total):
            return
        self._stored = block = ScanBlock.joined([*self._places.values()])
        self._places = {name: (block, number) for number, name in enumerate(self._places)}
        headers = map(header_of, block.records)
        header = {
            "version": VERSION,
            "scans": [*zip(self._stamps, self._stamps.values(), headers, strict=True)],
        }
        with suppress(ScoupError):  # a folder that is only read
            write_arrays(self._folder / KEPT, header, block.columns, overwrite=True)
