"""Where records of region sums are kept: in memory, in a temporary file once there are many, or in a file of a name."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from scoup.base.atomic import atomic_path
from scoup.base.errors import InputError
from scoup.uplift.storage.record_file import Record, RecordFile, bytes_of

MOST_IN_MEMORY = 256 << 20  # bytes; what comes after goes to a temporary file


class Store:
    """Records appended one after the other.

    Args:
        path: of the file; it is made with the first record. None for memory, or a temporary file.
        head: the record that a new file of a name begins with.
        most_in_memory: bytes kept in memory where there is no path.

    Attributes:
        bytes_in_memory: of the records kept there.
    """

    def __init__(self, path: Path | None, head: Record, most_in_memory: int = MOST_IN_MEMORY) -> None:
        self.bytes_in_memory = 0
        self._path = path
        self._head = head
        self._most_in_memory = most_in_memory
        self._file: RecordFile | None = None

    @classmethod
    def of_file(cls, file: RecordFile) -> Store:
        """The store of an open file."""
        store = cls(file.path, file.records[0])
        store._file = file
        return store

    @property
    def path(self) -> Path | None:
        """The file that the records are, or will be, in; None for memory or a temporary file."""
        return self._path

    @property
    def writable(self) -> bool:
        """Whether records can be appended."""
        return self._file is None or self._file.writable

    @property
    def bytes(self) -> int:
        """What all records take, in memory and on disk."""
        return self.bytes_in_memory + (0 if self._file is None else self._file.size)

    def append(self, kind: str, header: dict[str, Any], arrays: Mapping[str, NDArray[Any]]) -> Record:
        """Keep a record; returns it as it is kept.

        Raises:
            InputError: the file cannot be written.
        """
        size = bytes_of(arrays.values())
        if self._file is None:
            if self._path is not None:
                self._file = RecordFile.create(self._path)
                self._file.append(self._head.kind, self._head.header, self._head.arrays)
            elif self.bytes_in_memory + size > self._most_in_memory:
                self._file = RecordFile.temporary()
            else:
                self.bytes_in_memory += size
                return Record(kind, header, dict(arrays))
        return self._file.append(kind, header, arrays)

    def with_only(self, records: Iterable[Record]) -> tuple[Store, list[Record]]:
        """A store of these records alone in place of this one, which is closed, and the records as they are kept there.

        A file of a name is replaced as a whole, or stays as it is.

        Raises:
            InputError: the new file cannot be written.
        """
        if self._path is None:
            store = Store(None, self._head, self._most_in_memory)
            kept = [store.append(record.kind, record.header, record.arrays) for record in records]
            self.close()
            return store, kept
        with atomic_path(self._path, overwrite=True) as path:
            file = RecordFile.create(path)
            try:
                for record in (self._head, *records):
                    file.append(record.kind, record.header, record.arrays)
            finally:
                file.close()
            self.close()
        file = RecordFile.open(self._path, writable=True)
        return Store.of_file(file), file.records[1:]

    def forget_pages(self) -> None:
        """See ``RecordFile.forget_pages``."""
        if self._file is not None:
            self._file.forget_pages()

    def close(self) -> None:
        """Close the file, if there is one."""
        if self._file is not None:
            self._file.close()


@dataclass(frozen=True)
class Stores:
    """Several stores read as one.

    Attributes:
        parts: the stores.
    """

    parts: Sequence[Store | Stores]

    path = None
    writable = False

    @property
    def bytes(self) -> int:
        """What all records take, in memory and on disk."""
        return sum(part.bytes for part in self.parts)

    @property
    def bytes_in_memory(self) -> int:
        """What the records that are kept there take."""
        return sum(part.bytes_in_memory for part in self.parts)

    def append(self, kind: str, header: dict[str, Any], arrays: Mapping[str, NDArray[Any]]) -> Record:
        """Refused.

        Raises:
            InputError: always.
        """
        raise InputError("region sums of several files can be read only")

    def forget_pages(self) -> None:
        """See ``RecordFile.forget_pages``."""
        for part in self.parts:
            part.forget_pages()

    def close(self) -> None:
        """Close all files."""
        for part in self.parts:
            part.close()
