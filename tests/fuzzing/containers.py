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
import numpy as np
import zstandard
from safetensors.numpy import load, save

from scoup.base.sealed_file import array_checksum, sealed

_BASE64 = re.compile(rb"base64,([A-Za-z0-9+/=]*)")
_CHUNKS_OF_PIXELS = b"IDAT"


@dataclass(frozen=True)
class Container:
    """A kind of container."""

    split: Callable[[bytes], list[bytes]]  # the parts of a whole file
    join: Callable[
        [bytes, Sequence[bytes]], bytes
    ]  # of the whole file, and of its parts, which may be damaged


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
    (place,) = struct.unpack_from("<I", data, 16)
    parts, after = [data[:16]], place + 16 * data[15]
    for packed, original in struct.iter_unpack("<QQ", data[place:after]):
        parts.append(zstandard.decompress(data[after : after + packed], original))
        after += packed
    return parts


def _join_streams(data: bytes, parts: Sequence[bytes]) -> bytes:
    packed = [zstandard.compress(part) for part in parts[1:]]
    sizes = zip(map(len, packed), map(len, parts[1:]), strict=True)
    return parts[0] + data[16:32] + b"".join([*(struct.pack("<QQ", *each) for each in sizes), *packed])


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
    made = data[:8]
    for (kind, _), part in zip(_chunks(data), parts, strict=True):
        content = zlib.compress(part, 1) if kind == _CHUNKS_OF_PIXELS else part
        made += (
            struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))
        )
    return made


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
        rows = "SELECT value FROM parquet_kv_metadata(?) WHERE key = 'scoup'"
        return [value for (value,) in duckdb.connect().execute(rows, [str(path)]).fetchall()]


def _join_parquet(data: bytes, parts: Sequence[bytes]) -> bytes:
    text = parts[0].decode("utf-8", "replace").replace("\0", " ").replace("'", "''")
    with TemporaryDirectory() as folder:
        path, made = Path(folder, "a.parquet"), Path(folder, "b.parquet")
        path.write_bytes(data)
        copy = f"COPY rows TO '{made}' (FORMAT parquet, KV_METADATA {{scoup: '{text}'}})"
        duckdb.connect().read_parquet(str(path)).query("rows", copy)
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
    root = json.loads(_split_safetensors(data)[0])
    text = parts[0].decode("utf-8", "replace")
    root["__metadata__"]["scoup"] = text
    first = _join_safetensors(data, [json.dumps(root).encode(), parts[1]])
    try:
        checksums = {name: array_checksum(item) for name, item in load(first).items()}
        root["__metadata__"]["scoup"] = sealed({**json.loads(text), "checksums": checksums})
    except Exception:  # safetensors has its own; what cannot be fixed stays as it is
        return first
    return _join_safetensors(data, [json.dumps(root).encode(), parts[1]])


def _label_maps(data: bytes) -> list[str]:
    """Return the names of the packed label maps of a .regions file."""
    return sorted(name for name in load(data) if name.startswith("labels."))


def _split_labels(data: bytes) -> list[bytes]:
    tensors = load(data)
    return [zlib.decompress(tensors[name].tobytes()) for name in _label_maps(data)]


def _join_labels(data: bytes, parts: Sequence[bytes]) -> bytes:
    packed = [np.frombuffer(zlib.compress(part, 1), np.uint8) for part in parts]
    tensors = load(data) | dict(zip(_label_maps(data), packed, strict=True))
    made = save(tensors, json.loads(_split_safetensors(data)[0])["__metadata__"])
    return _join_sealed(made, _split_sealed(made))


def _split_npy(data: bytes) -> list[bytes]:
    start = 10 + int.from_bytes(data[8:10], "little")
    return [data[10:start], data[start:]]


def _join_npy(data: bytes, parts: Sequence[bytes]) -> bytes:
    text = parts[0][:65535]
    return data[:8] + struct.pack("<H", len(text)) + text + parts[1]


def join_parts(container: Container, data: bytes, parts: Sequence[bytes]) -> bytes:
    """Run ``container.join`` without the warnings of libraries about strange parts."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return container.join(data, parts)


GZIP = Container(
    lambda data: [gzip.decompress(data)], lambda data, parts: gzip.compress(parts[0], 1, mtime=0)
)
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
PLY = Container(
    lambda data: [data[: data.index(b"end_header")], data[data.index(b"end_header") :]],
    lambda data, parts: b"".join(parts),
)
