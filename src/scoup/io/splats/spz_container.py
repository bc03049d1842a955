"""The container of .spz files: one gzip stream (versions 1 to 3), or a header and a zstd stream an attribute (version
4)."""

from __future__ import annotations

import gzip
import io
import struct
import warnings
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from scoup.base import FileFormatError, ScoupWarning, WorldFrame, counted
from scoup.io.splats.spz_georeference import GEOREFERENCE, georeference_record, read_georeference

MAGIC = 0x5053474E  # "NGSP"
# Magic, version, count, SH degree, fraction bits, flags, reserved or streams.
_START = struct.Struct("<IIIBBBB")
_PLACE = struct.Struct("<I12x")  # of the table of streams; the rest of the header of version 4
_STREAM = struct.Struct("<QQ")  # compressed and original size
_RECORD = struct.Struct("<II")  # of an extension: type and bytes behind it
_ANTIALIASED, _HAS_EXTENSIONS = 1, 2
_ORBIT, _AXES = 0xADBE0002, 0xADBE0003  # limits of a viewer's camera; the axes of the values
_MOST_RECORDS = 1 << 16  # bytes of the extensions of a version before 4
_MOST_DEGREE = 4
_ANY_WINDOW, _MOST_WINDOW = 1 << 23, 1 << 27  # bytes: of any stream by the usual levels of zstd, and of all
# What unpacks to more than both is made to fill the memory; scenes shrink tenfold.
_RATIO, _ANY_BYTES = 100, 4 << 20
_DAMAGED = "the file is damaged; copy or export it again"


@dataclass(frozen=True)
class SpzHeader:
    """The header before the attributes."""

    version: int  # 1 to 4
    count: int  # N, of Gaussians
    degree: int  # of the spherical harmonics, 0 to 4
    fraction_bits: int  # bits after the binary point of a coordinate
    antialiased: bool = False  # rasterised with compensated opacities
    axes: str = "RUB"  # directions of x, y, z: left or right, up or down, front or back
    world: WorldFrame = field(default_factory=WorldFrame)  # in axes right, up, back

    @property
    def row_sizes(self) -> dict[str, int]:
        """Bytes of each attribute of a Gaussian."""
        return {
            "positions": 6 if self.version == 1 else 9,
            "alphas": 1,
            "colors": 3,
            "scales": 3,
            "rotations": 4 if self.version >= 3 else 3,
            "sh": 3 * ((self.degree + 1) ** 2 - 1),
        }

    @property
    def sizes(self) -> dict[str, int]:
        return {name: self.count * size for name, size in self.row_sizes.items()}


def read_container(path: Path, content: bytes) -> tuple[SpzHeader, dict[str, bytes]]:
    """Return the header and the attributes' bytes, each of its full size."""
    if content[:4] == MAGIC.to_bytes(4, "little"):
        return _read_streams(path, content)
    if content[:2] != b"\x1f\x8b":
        raise FileFormatError(path, "is not a .spz file (neither gzip nor NGSP at its start)", _DAMAGED)
    unpacker = zlib.decompressobj(16 + zlib.MAX_WBITS)
    try:
        start = unpacker.decompress(content, _START.size)
        header, flags, _ = _header(path, start, len(content))
        wanted = sum(header.sizes.values())
        body = unpacker.decompress(unpacker.unconsumed_tail, wanted) if wanted else b""
        extended = flags & _HAS_EXTENSIONS
        # The checksum is behind the last byte, and is compared only when that is asked for.
        more = unpacker.decompress(unpacker.unconsumed_tail, _MOST_RECORDS if extended else 1)
    except zlib.error as error:
        raise FileFormatError(path, f"cannot be unpacked ({error})", _DAMAGED) from error
    if len(body) != wanted or (more and not extended) or not unpacker.eof:
        raise FileFormatError(
            path, f"does not contain the {header.count:,} Gaussians of its header", _DAMAGED
        )
    parts, offset = {}, 0
    for name, size in header.sizes.items():
        parts[name] = body[offset : offset + size]
        offset += size
    return _extended(path, header, more), parts


def write_container(header: SpzHeader, parts: Mapping[str, bytes]) -> bytes:
    """Return the bytes of a file; the same for the same header and attributes."""
    record = georeference_record(header.world)
    records = _RECORD.pack(GEOREFERENCE, len(record)) + record if record else b""
    flags = (_ANTIALIASED if header.antialiased else 0) | (_HAS_EXTENSIONS if records else 0)
    start = (MAGIC, header.version, header.count, header.degree, header.fraction_bits, flags)
    if header.version < 4:
        packed = io.BytesIO()
        with gzip.GzipFile("", "wb", 9, packed, mtime=0) as stream:
            stream.writelines([_START.pack(*start, 0), *(parts[name] for name in header.sizes), records])
        return packed.getvalue()
    import zstandard

    # Without higher harmonics there is no stream of them; the format's own reader counts.
    names = [name for name, size in header.row_sizes.items() if size]
    streams = [zstandard.ZstdCompressor(level=12).compress(parts[name]) for name in names]
    table = [_STREAM.pack(len(data), len(parts[name])) for name, data in zip(names, streams, strict=True)]
    head = _START.pack(*start, len(streams)) + _PLACE.pack(_START.size + _PLACE.size + len(records))
    return b"".join([head, records, *table, *streams])


def _read_streams(path: Path, content: bytes) -> tuple[SpzHeader, dict[str, bytes]]:
    """Read a container of version 4; records of extensions are before the table."""
    header, flags, count = _header(path, content, len(content))
    if header.version < 4 or len(content) < _START.size + _PLACE.size:
        raise FileFormatError(path, "is cut short, or its header is damaged", _DAMAGED)
    (offset,) = _PLACE.unpack_from(content, _START.size)
    after = offset + count * _STREAM.size
    if (
        offset < _START.size + _PLACE.size
        or after > len(content)
        or count < len(header.sizes) - (not header.degree)
    ):
        raise FileFormatError(path, "has no whole table of streams", _DAMAGED)
    if flags & _HAS_EXTENSIONS:
        header = _extended(path, header, content[_START.size + _PLACE.size : offset])
    parts = {}
    for number, (name, size) in enumerate(header.sizes.items()):
        if number >= count:
            parts[name] = b""
            continue
        packed, original = _STREAM.unpack_from(content, offset + number * _STREAM.size)
        if original != size or after + packed > len(content):
            problem = f"has {name} of {original} bytes for {header.count:,} Gaussians, or is cut short"
            raise FileFormatError(path, problem, _DAMAGED)
        parts[name] = _unpacked(path, content[after : after + packed], size)
        after += packed
    return header, parts


def _extended(path: Path, header: SpzHeader, records: bytes) -> SpzHeader:
    """Return the header with the records of extensions applied; unknown ones get a warning."""
    offset = 0
    while offset < len(records):
        kind, size = _RECORD.unpack_from(records.ljust(offset + _RECORD.size, b"\0"), offset)
        start = offset + _RECORD.size
        offset = start + size
        if offset > len(records):
            raise FileFormatError(path, "has a record of an extension that is cut short", _DAMAGED)
        if kind == _AXES:
            number = int.from_bytes(records[start:offset], "little")
            if number > 16 or size != 4:
                problem = f"has axes of the unknown kind {number}"
                raise FileFormatError(path, problem, "export it again without SPZ_ADOBE_coordinate_system")
            header = replace(header, axes=_axes(number))
        elif kind == GEOREFERENCE and (world := read_georeference(records[start:offset])) is not None:
            header = replace(header, world=world)
        elif kind != _ORBIT:
            warnings.warn(
                f"{path}: the extension {kind:#010x} ({counted(size, 'byte')}) is unknown and was not read; values "
                "that it changes are wrong",
                ScoupWarning,
                stacklevel=2,
            )
    return header


def _axes(number: int) -> str:
    """Return the directions of x, y, z for a number of the extension."""
    bits = (number or 4) - 1  # 0: not said
    x, height, depth = "LR"[bits & 1], "DU"[bits >> 1 & 1], "BF"[bits >> 2 & 1]
    return f"{x}{'FB'[bits >> 2 & 1]}{height}" if bits & 8 else f"{x}{height}{depth}"


def _header(path: Path, start: bytes, available: int) -> tuple[SpzHeader, int, int]:
    """Return the header of a file of ``available`` bytes, which limit the Gaussians that it can hold, by its unpacked
    ``start``; its flags, and its last byte."""
    if len(start) < _START.size:
        raise FileFormatError(path, "is cut short within its header", _DAMAGED)
    magic, version, count, degree, bits, flags, last = _START.unpack_from(start)
    if magic != MAGIC:
        raise FileFormatError(path, "is a compressed file, but not of Gaussians (.spz)", "check the path")
    if not 1 <= version <= 4:
        problem = f"is of version {version} of .spz; versions 1 to 4 are read"
        raise FileFormatError(path, problem, "export it again as an older version, or as PLY")
    if degree > _MOST_DEGREE or bits > 23:
        problem = f"says SH degree {degree} and {bits} bits of fractions, which cannot be"
        raise FileFormatError(path, problem, _DAMAGED)
    header = SpzHeader(version, count, degree, bits, bool(flags & _ANTIALIASED))
    if sum(header.sizes.values()) > max(_ANY_BYTES, _RATIO * available):
        problem = f"says {count:,} Gaussians, more than {available:,} bytes can hold"
        raise FileFormatError(path, problem, _DAMAGED)
    return header, flags, last


def _unpacked(path: Path, packed: bytes, size: int) -> bytes:
    """Return the contents of a zstd stream that must have ``size`` bytes; no more are unpacked than these and one."""
    import zstandard

    try:
        # A window is memory, and no frame needs one that is larger than what it holds.
        window = max(_ANY_WINDOW, min(_MOST_WINDOW, 1 << size.bit_length()))
        with zstandard.ZstdDecompressor(max_window_size=window).stream_reader(packed) as stream:
            content = stream.read(size + 1)
    except (zstandard.ZstdError, MemoryError) as error:
        raise FileFormatError(path, f"cannot be unpacked ({error})", _DAMAGED) from error
    if len(content) != size:
        raise FileFormatError(path, f"has a stream that does not unpack to its {size:,} bytes", _DAMAGED)
    return content
