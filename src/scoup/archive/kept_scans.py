"""Scans of an archive that were read before, and are in memory."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from scoup.archive.read_scans import ScanBlock, read_blocks, read_scans
from scoup.archive.scan_files import Scan, ScanRecord

if TYPE_CHECKING:
    from duckdb import DuckDBPyConnection

SCANS_AT_A_TIME = 16  # of which all is read together
SCANS_KEPT = 128  # with all that is known of them
Place: TypeAlias = "tuple[ScanBlock, int]"
"""A scan: its block, and its number there."""


class KeptScans:
    """What ranks the things of all scans, and all of some scans; files that have not changed are read once.

    Args:
        connection: of the archive.
        read_records: of files.
    """

    def __init__(
        self,
        connection: DuckDBPyConnection,
        read_records: Callable[[Sequence[Path]], list[ScanRecord]],
    ) -> None:
        self._connection = connection
        self._read_records = read_records
        self._places: dict[Path, tuple[tuple[int, int], Place]] = {}
        self._scans: dict[ScanRecord, Scan] = {}

    def places(self, wanted: Sequence[Path]) -> list[Place]:
        """Return the scans of files as they are now."""
        files, stamps = dict.fromkeys(wanted), dict[Path, tuple[int, int]]()
        for file in files:
            with suppress(FileNotFoundError):  # removed meanwhile
                state = file.stat()
                stamps[file] = state.st_mtime_ns, state.st_size
        known = {
            file: of
            for file, of in self._places.items()
            if stamps.get(file) == of[0] or (file not in files and file.exists())
        }
        new = [file for file in stamps if file not in known]
        for block in read_blocks(self._read_records(new), self._connection.cursor()):
            for number, record in enumerate(block.records):
                known[record.file] = stamps[record.file], (block, number)
        self._places = known
        return [known[file][1] for file in stamps]

    def scans(self, places: Sequence[Place]) -> Iterator[Scan]:
        """Yield all that is known of scans; some that follow are read with the next."""
        for start in range(0, len(places), SCANS_AT_A_TIME):
            some = {
                block.records[number]: (block, number)
                for block, number in places[start : start + SCANS_AT_A_TIME]
            }
            kept = {record: self._scans.pop(record) for record in some if record in self._scans}
            new = [record for record in some if record not in kept]
            read = read_scans([some[record] for record in new], self._connection.cursor())
            scans = kept | dict(zip(new, read, strict=True))
            self._scans |= scans  # those asked last are the last
            for record in [*self._scans][:-SCANS_KEPT]:
                del self._scans[record]
            yield from (scans[record] for record in some)
