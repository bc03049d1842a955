"""A file of records that grows at its end: arrays with a JSON header each, checked, and mapped into memory when read.

Nothing that was written is ever changed. A record that was cut short by an interruption is passed over and, when the
file is opened for more, cut off: whatever was complete stays (docs/formats.md).
"""

from __future__ import annotations

import json
import mmap
import os
import struct
import zlib
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from scoup.base.errors import FileFormatError, InputError, MissingFileError, WriteError, refused_read
from scoup.base.scratch import refused_temporary, temporary_file

MAGIC = b"SCOUPREC"
_HEAD = struct.Struct("<8sIQI")  # magic, CRC-32 and length of what follows, CRC-32 of the head so far
_ALIGNMENT = 64
_TYPES = ("uint8", "uint16", "uint32", "int32", "int64", "float16", "float32")
_AT_A_TIME = 1 << 24


@dataclass(frozen=True, eq=False)
class Record:
    """One record of a file.

    Attributes:
        kind: what it is.
        header: its JSON values.
        arrays: read-only, backed by the file.
    """

    kind: str
    header: dict[str, Any]
    arrays: dict[str, NDArray[Any]]


class RecordFile:
    """Records appended one after the other. Made by ``create``, ``open`` or ``temporary``.

    Attributes:
        path: the file; None for a temporary one.
        records: those in the file, in order.
        writable: whether more can be appended.
    """

    def __init__(self, stream: IO[bytes], path: Path | None, writable: bool) -> None:
        self.path = path
        self.writable = writable
        self.records: list[Record] = []
        self._stream = stream
        self._end = 0
        self._ends: list[int] = []  # of the records
        self._maps: list[mmap.mmap] = []

    @classmethod
    def create(cls, path: Path) -> RecordFile:
        """A new, empty file in place of what is there.

        Raises:
            InputError: it cannot be written.
        """
        try:
            return cls(path.open("w+b", buffering=0), path, True)
        except OSError as error:
            raise WriteError.of(path, error) from error

    @classmethod
    def temporary(cls) -> RecordFile:
        """A new file without a name, in the system's folder for such (TMPDIR); gone when it is closed.

        Raises:
            WriteError: there is no such folder.
        """
        return cls(temporary_file(), None, True)

    @classmethod
    def open(cls, path: Path, writable: bool = False) -> RecordFile:
        """A file that is there. Every record is read once, to compare its checksum.

        Raises:
            MissingFileError, FileFormatError: there is no such file, it is another one, or damaged.
        """
        if not path.is_file():
            raise MissingFileError(path, "there is no such file", "check the path")
        try:
            stream = path.open("r+b" if writable else "rb", buffering=0)
        except OSError as error:
            # No FileFormatError: what cannot be opened is not damaged, and nobody is to make it anew.
            raise InputError(str(refused_read(path, error))) from error
        file = cls(stream, path, writable)
        try:
            file._read_all()
        except BaseException:
            file.close()
            raise
        return file

    @property
    def size(self) -> int:
        """Bytes of the complete records."""
        return self._end

    def append(self, kind: str, header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> Record:
        """Write a record behind the others. What a refused write has left is cut off.

        Raises:
            WriteError: there is no room on the disk, or the like.
        """
        if not self.writable:
            raise InputError(f"{self.path}: was opened for reading only")
        layout, offset = {}, 0
        for name, array in arrays.items():
            layout[name] = {"dtype": str(array.dtype), "shape": list(array.shape), "offset": offset}
            offset += _padded(array.nbytes)
        text = json.dumps({"kind": kind, "header": header, "arrays": layout}, sort_keys=True).encode()
        text += b" " * (_padded(_HEAD.size + 8 + len(text)) - _HEAD.size - 8 - len(text))
        parts: list[bytes | memoryview] = [struct.pack("<Q", len(text)), text]
        for array in arrays.values():
            parts += [np.ascontiguousarray(array).data.cast("B") if array.nbytes else b""]
            parts += [bytes(_padded(array.nbytes) - array.nbytes)]
        checksum = 0
        for part in parts:
            checksum = zlib.crc32(part, checksum)
        length = sum(len(part) for part in parts)
        head = _head(checksum, length)
        try:
            self._stream.seek(self._end)
            for part in [head, *parts]:
                self._write(part)
        except OSError as error:
            with suppress(OSError):
                self._stream.truncate(self._end)
            raise _refused(self.path, error) from error
        record = self._map(self._end, length, kind, dict(header), layout)
        self.records.append(record)
        self._end += len(head) + length
        self._ends.append(self._end)
        return record

    def cut(self, count: int) -> None:
        """Cut off all records but the first ``count``, of which there is at least one.

        Arrays of the others must not be read any more.
        """
        self._end = self._ends[count - 1]
        del self.records[count:], self._ends[count:]
        self._stream.truncate(self._end)

    def forget_pages(self) -> None:
        """Let the system take back the memory through which the file was read; what is needed is read again."""
        if hasattr(mmap, "MADV_DONTNEED"):
            for mapped in self._maps:
                mapped.madvise(mmap.MADV_DONTNEED)

    def close(self) -> None:
        """Close the file; arrays of its records stay readable while they are held."""
        self._stream.close()

    def _write(self, part: bytes | memoryview) -> None:
        """All of a part: without a buffer, the system may take less than it is given."""
        rest = memoryview(part)
        while rest:
            rest = rest[self._stream.write(rest) :]

    def _read_all(self) -> None:
        size = os.fstat(self._stream.fileno()).st_size
        while self._end < size:
            record = self._read(self._end, size)
            if record is None:
                break
            self.records.append(record[0])
            self._end += _HEAD.size + record[1]
            self._ends.append(self._end)
        if not self.records:
            raise FileFormatError(self._named, "holds no complete record of region sums", "make it again")
        if self.writable and self._end < size:
            self._stream.truncate(self._end)

    def _read(self, start: int, size: int) -> tuple[Record, int] | None:
        """The record that starts there and its length; None if it was cut short."""
        self._stream.seek(start)
        head = self._stream.read(_HEAD.size)
        if len(head) < _HEAD.size:
            return None
        _, checksum, length, _ = _HEAD.unpack(head)
        end = start + _HEAD.size + length
        if head == _head(checksum, length):
            if end <= size and self._checksum(length) == checksum:
                return self._parsed(start, length), length
            if end >= size:
                return None
        elif start == 0:
            raise FileFormatError(self._named, "is not a file of region sums", "check the path")
        elif not any(head):  # a file that had grown when the machine stopped
            return None
        raise FileFormatError(
            self._named,
            f"is damaged at byte {start} (checksum)",
            "copy it again, or make the region sums again",
        )

    def _checksum(self, length: int) -> int:
        checksum = 0
        while length > 0:
            block = self._stream.read(min(length, _AT_A_TIME))
            if not block:
                return -1
            checksum = zlib.crc32(block, checksum)
            length -= len(block)
        return checksum

    def _parsed(self, start: int, length: int) -> Record:
        self._stream.seek(start + _HEAD.size)
        try:
            text_length = struct.unpack("<Q", self._stream.read(8))[0]
            if text_length > length:
                raise ValueError("a header longer than its record")
            content = json.loads(self._stream.read(text_length))
            kind, header, layout = content["kind"], content["header"], content["arrays"]
            if not (isinstance(kind, str) and isinstance(header, dict) and isinstance(layout, dict)):
                raise ValueError("a header of another form")
            return self._map(start, length, kind, header, layout)
        except (KeyError, TypeError, ValueError, struct.error, OverflowError, RecursionError) as error:
            raise FileFormatError(
                self._named, f"holds a record that makes no sense ({error})", "make the region sums again"
            ) from error

    def _map(
        self, start: int, length: int, kind: str, header: dict[str, Any], layout: dict[str, Any]
    ) -> Record:
        """The record whose head starts at ``start``, its arrays mapped."""
        self._stream.seek(start + _HEAD.size)
        text_length = struct.unpack("<Q", self._stream.read(8))[0]
        first, end = start + _HEAD.size + 8 + text_length, start + _HEAD.size + length
        page = first // mmap.ALLOCATIONGRANULARITY * mmap.ALLOCATIONGRANULARITY
        arrays: dict[str, NDArray[Any]] = {}
        mapped = None
        if end > first:
            mapped = mmap.mmap(self._stream.fileno(), end - page, access=mmap.ACCESS_READ, offset=page)
            self._maps.append(mapped)
        for name, item in layout.items():
            if item["dtype"] not in _TYPES:
                raise ValueError(f"an array of {item['dtype']}")
            shape, offset = tuple(int(n) for n in item["shape"]), int(item["offset"])
            dtype = np.dtype(item["dtype"])
            count = int(np.prod(shape, dtype=object)) if shape else 1
            if min((*shape, offset)) < 0 or first + offset + count * dtype.itemsize > end:
                raise ValueError("an array beyond its record")
            if mapped is None or count == 0:
                arrays[name] = np.zeros(shape, dtype)
            else:
                arrays[name] = np.frombuffer(mapped, dtype, count, first - page + offset).reshape(shape)
        return Record(kind, header, arrays)

    @property
    def _named(self) -> Path:
        return self.path or Path("temporary file")


def _refused(path: Path | None, error: OSError) -> WriteError:
    """The error of a file that cannot be written."""
    return refused_temporary(error) if path is None else WriteError.of(path, error)


def _head(checksum: int, length: int) -> bytes:
    return _HEAD.pack(MAGIC, checksum, length, zlib.crc32(_HEAD.pack(MAGIC, checksum, length, 0)))


def _padded(size: int) -> int:
    return -(-size // _ALIGNMENT) * _ALIGNMENT


def bytes_of(arrays: Iterable[NDArray[Any]]) -> int:
    """What arrays take in memory."""
    return sum(array.nbytes for array in arrays)
