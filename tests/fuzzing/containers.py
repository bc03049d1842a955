"""Containers that are split and joined again, so that damage reaches their content: lengths and checksums fit."""

from __future__ import annotations

import base64
import gzip
import io
import json
import re
import struct
import warnings
import zipfile
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import duckdb

from scoup.base.sealed_file import NO_CHECKSUM, array_checksum, sealed
from scoup.uplift.storage.array_file import with_checksum

_BASE64 = re.compile(rb"base64,([A-Za-z0-9+/=]*)")
_CHUNKS_OF_PIXELS = b"IDAT"


@dataclass(frozen=True)
class Container:
    """A kind of container."""

    split: Callable[[bytes], list[bytes]]  # the parts of a whole file
    # a file of these parts, which may be damaged; given the whole file they came from
    join: Callable[[bytes, Sequence[bytes]], bytes]


def _split_zip(data: bytes) -> list[bytes]:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        return [archive.read(entry) for entry in archive.infolist()]


def _join_zip(data: bytes, parts: Sequence[bytes]) -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as archive, zipfile.ZipFile(packed, "w") as made:
        for entry, part in zip(archive.infolist(), parts, strict=True):
            copy = zipfile.ZipInfo(entry.filename)
            copy.compress_type = entry.compress_type
            made.writestr(copy, part)
    return packed.getvalue()


def _split_streams(data: bytes) -> list[bytes]:
    """Return header and unpacked streams of .spz, version 4."""
    import zstandard

    (place,) = struct.unpack_from("<I", data, 16)
    parts, after = [data[:16]], place + 16 * data[15]
    for number in range(data[15]):
        packed, original = struct.unpack_from("<QQ", data, place + 16 * number)
        parts.append(zstandard.ZstdDecompressor().decompress(data[after : after + packed], original))
        after += packed
    return parts


def _join_streams(data: bytes, parts: Sequence[bytes]) -> bytes:
    import zstandard

    packed = [zstandard.ZstdCompressor().compress(part) for part in parts[1:]]
    table = b"".join(
        struct.pack("<QQ", len(some), len(part)) for some, part in zip(packed, parts[1:], strict=True)
    )
    return parts[0] + data[16:32] + table + b"".join(packed)


def _chunks(data: bytes) -> list[tuple[bytes, bytes]]:
    """Return kinds and contents of the chunks of a PNG, all pixels in one."""
    found: list[tuple[bytes, bytes]] = []
    place = 8
    while place < len(data):
        size, kind = struct.unpack_from(">I4s", data, place)
        content = data[place + 8 : place + 8 + size]
        if found and found[-1][0] == kind == _CHUNKS_OF_PIXELS:
            content = found.pop()[1] + content
        found.append((kind, content))
        place += 12 + size
    return found


def _split_png(data: bytes) -> list[bytes]:
    return [zlib.decompress(part) if kind == _CHUNKS_OF_PIXELS else part for kind, part in _chunks(data)]


def _join_png(data: bytes, parts: Sequence[bytes]) -> bytes:
    made = [data[:8]]
    for (kind, _), part in zip(_chunks(data), parts, strict=True):
        content = zlib.compress(part, 1) if kind == _CHUNKS_OF_PIXELS else part
        made += [struct.pack(">I", len(content)), kind, content]
        made.append(struct.pack(">I", zlib.crc32(kind + content)))
    return b"".join(made)


def _split_glb(data: bytes) -> list[bytes]:
    (size,) = struct.unpack_from("<I", data, 12)
    return [data[20 : 20 + size], data[28 + size :]]


def _join_glb(data: bytes, parts: Sequence[bytes]) -> bytes:
    text, binary = (part + b" " * (-len(part) % 4) for part in parts)
    start = struct.pack("<4sIII4s", b"glTF", 2, 28 + len(text) + len(binary), len(text), b"JSON")
    return start + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary


def _split_base64(data: bytes) -> list[bytes]:
    return [base64.b64decode(hit[1]) for hit in _BASE64.finditer(data)]


def _join_base64(data: bytes, parts: Sequence[bytes]) -> bytes:
    rest = iter(parts)
    return _BASE64.sub(lambda _: b"base64," + base64.b64encode(next(rest)), data)


def split_parquet(data: bytes) -> list[bytes]:
    """Return SCOUP's header."""
    with TemporaryDirectory() as folder:
        path = Path(folder, "a.parquet")
        path.write_bytes(data)
        rows = duckdb.connect().execute(
            "SELECT value FROM parquet_kv_metadata(?) WHERE key = 'scoup'", [str(path)]
        )
        return [value for (value,) in rows.fetchall()]


def _join_parquet(data: bytes, parts: Sequence[bytes]) -> bytes:
    text = parts[0].decode("utf-8", "replace").replace("\0", " ").replace("'", "''")
    with TemporaryDirectory() as folder:
        path, made = Path(folder, "a.parquet"), Path(folder, "b.parquet")
        path.write_bytes(data)
        rows = duckdb.connect().read_parquet(str(path))
        rows.query("rows", f"COPY rows TO '{made}' (FORMAT parquet, KV_METADATA {{scoup: '{text}'}})")
        return made.read_bytes()


def _split_safetensors(data: bytes) -> list[bytes]:
    (size,) = struct.unpack_from("<Q", data)
    return [data[8 : 8 + size], data[8 + size :]]


def _join_safetensors(data: bytes, parts: Sequence[bytes]) -> bytes:
    text = parts[0] + b" " * (-len(parts[0]) % 8)
    return struct.pack("<Q", len(text)) + text + parts[1]


def _split_sealed(data: bytes) -> list[bytes]:
    """Return SCOUP's header, and the numbers of all tensors."""
    text, body = _split_safetensors(data)
    return [json.loads(text)["__metadata__"]["scoup"].encode(), body]


def _join_sealed(data: bytes, parts: Sequence[bytes]) -> bytes:
    """Return a file whose checksums agree, as far as its header is JSON still."""
    from safetensors.numpy import load

    root = json.loads(_split_safetensors(data)[0])
    text = parts[0].decode("utf-8", "replace")
    root["__metadata__"]["scoup"] = text
    first = _join_safetensors(data, [json.dumps(root).encode(), parts[1]])
    try:
        header = json.loads(text)
        header |= {"checksums": {name: array_checksum(item) for name, item in load(first).items()}}
    except Exception:  # safetensors has its own; what cannot be fixed stays as it is
        return first
    root["__metadata__"]["scoup"] = sealed(header)
    return _join_safetensors(data, [json.dumps(root).encode(), parts[1]])


def _split_labels(data: bytes) -> list[bytes]:
    """Return the unpacked label maps of a .regions file."""
    from safetensors.numpy import load

    return [
        zlib.decompress(item.tobytes())
        for name, item in sorted(load(data).items())
        if name.startswith("labels.")
    ]


def _join_labels(data: bytes, parts: Sequence[bytes]) -> bytes:
    import numpy as np
    from safetensors.numpy import load, save

    tensors, rest = load(data), iter(parts)
    for name in sorted(tensors):
        if name.startswith("labels."):
            tensors[name] = np.frombuffer(zlib.compress(next(rest), 1), np.uint8)
    made = save(tensors, json.loads(_split_safetensors(data)[0])["__metadata__"])
    return _join_sealed(made, _split_sealed(made))


def _split_npy(data: bytes) -> list[bytes]:
    start = 10 + int.from_bytes(data[8:10], "little")
    return [data[10:start], data[start:]]


def _join_npy(data: bytes, parts: Sequence[bytes]) -> bytes:
    text = parts[0][:65535]
    return data[:8] + struct.pack("<H", len(text)) + text + parts[1]


def _join_sums(data: bytes, parts: Sequence[bytes]) -> bytes:
    """Return a file of region sums whose checksum agrees."""
    made = _join_safetensors(data, parts)
    end = 8 + int.from_bytes(made[:8], "little")
    head = made[8:end]
    checksum = zlib.crc32(made[end:], zlib.crc32(with_checksum(head, NO_CHECKSUM)))
    return made[:8] + with_checksum(head, f"{checksum:08x}") + made[end:]


def _split_ply(data: bytes) -> list[bytes]:
    end = data.index(b"end_header")
    return [data[:end], data[end:]]


def _rejoined(data: bytes, parts: Sequence[bytes]) -> bytes:
    return b"".join(parts)


def _join_gzip(data: bytes, parts: Sequence[bytes]) -> bytes:
    return gzip.compress(parts[0], 1, mtime=0)


def join_parts(container: Container, data: bytes, parts: Sequence[bytes]) -> bytes:
    """Run ``container.join`` without the warnings of libraries about strange parts."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return container.join(data, parts)


GZIP = Container(lambda data: [gzip.decompress(data)], _join_gzip)
ZIP = Container(_split_zip, _join_zip)
STREAMS = Container(_split_streams, _join_streams)
PNG = Container(_split_png, _join_png)
GLB = Container(_split_glb, _join_glb)
BASE64 = Container(_split_base64, _join_base64)
SAFETENSORS = Container(_split_safetensors, _join_safetensors)
SEALED = Container(_split_sealed, _join_sealed)
LABELS = Container(_split_labels, _join_labels)
PARQUET = Container(split_parquet, _join_parquet)
NPY = Container(_split_npy, _join_npy)
SUMS = Container(_split_safetensors, _join_sums)
PLY = Container(_split_ply, _rejoined)
