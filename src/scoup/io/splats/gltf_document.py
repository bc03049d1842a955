"""glTF files as they are stored: the JSON of a .gltf or .glb file and the bytes of its buffers, all checked."""

from __future__ import annotations

import base64
import binascii
import json
import struct
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import unquote

from scoup.base.counts import counted
from scoup.base.errors import FileFormatError
from scoup.base.existing import existing_file
from scoup.io.reading import read_bytes

MAGIC = b"glTF"
HEADER, CHUNK = struct.Struct("<4sII"), struct.Struct("<I4s")
JSON_CHUNK, BINARY_CHUNK = b"JSON", b"BIN\0"
_LARGEST = 2**53  # beyond it JSON numbers are not exact; no count or size of a file comes near
_DAMAGED = "the file is damaged; export it again"


class GltfDocument:
    """The JSON of a glTF file and its buffers; every access to either is checked.

    Args:
        root: its JSON.
        binary: the binary chunk of a .glb file.
    """

    def __init__(self, path: Path, root: dict[str, Any], binary: memoryview | None) -> None:
        self.path = path
        self.root = root
        self._binary = binary
        self._sources: dict[str, bytes] = {}

    def error(self, problem: str, remedy: str = _DAMAGED) -> FileFormatError:
        """Return the error that says what is wrong with the file."""
        return FileFormatError(self.path, problem, remedy)

    def whole(self, value: Any, what: str, low: int = 0, default: int | None = None) -> int:
        """Return ``value`` as a whole number of at least ``low``; ``default`` where it is missing."""
        if value is None and default is not None:
            return default
        if isinstance(value, float) and value == value // 1 and abs(value) < _LARGEST:
            value = int(value)
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value < _LARGEST:
            raise self.error(f"{what} is not a whole number from {low}")
        return value

    def entries(self, name: str) -> list[Any]:
        """Return the list ``name`` at the top of the JSON; empty where there is none."""
        value = self.root.get(name, [])
        if not isinstance(value, list):
            raise self.error(f"{name} is not a list")
        return value

    def entry(self, name: str, index: Any, what: str) -> dict[str, Any]:
        """Return the object that ``what`` points to by its index in the list ``name``."""
        items = self.entries(name)
        number = self.whole(index, f"the index of {what}")
        if number >= len(items):
            raise self.error(f"{what} is {name}[{number}], but {name} has {len(items)}")
        if not isinstance(items[number], dict):
            raise self.error(f"{name}[{number}] is not an object")
        return items[number]

    def names(self, name: str) -> list[str]:
        """Return a list of names at the top of the JSON, such as ``extensionsUsed``."""
        return [item for item in self.entries(name) if isinstance(item, str)]

    @property
    def data_bytes(self) -> int:
        """Return how many bytes of buffers were opened so far."""
        return (0 if self._binary is None else len(self._binary)) + sum(map(len, self._sources.values()))

    def view(self, index: Any, what: str) -> tuple[memoryview, int]:
        """Return the bytes of a buffer view and its stride (0 where it has none)."""
        entry = self.entry("bufferViews", index, f"the buffer view of {what}")
        data = self._buffer(entry.get("buffer"), what)
        offset = self.whole(entry.get("byteOffset"), f"the offset of {what}", default=0)
        length = self.whole(entry.get("byteLength"), f"the length of {what}", low=1)
        if offset + length > len(data):
            raise self.error(f"the buffer view of {what} reaches beyond its buffer")
        return data[offset : offset + length], self.whole(
            entry.get("byteStride"), f"the stride of {what}", default=0
        )

    def _buffer(self, index: Any, what: str) -> memoryview:
        entry = self.entry("buffers", index, f"the buffer of {what}")
        length = self.whole(entry.get("byteLength"), f"the length of the buffer of {what}", low=1)
        uri = entry.get("uri")
        if uri is None:
            if self._binary is None or index != 0:
                raise self.error(f"the buffer of {what} has no data")
            data = self._binary
        elif isinstance(uri, str):
            data = self._embedded(uri) if uri[:5].lower() == "data:" else self._external(uri)
        else:
            raise self.error(f"the URI of the buffer of {what} is not a text")
        if len(data) < length:
            raise self.error(
                f"a buffer contains {counted(len(data), 'byte')}, but its JSON says {length}",
                "the file is cut short; copy it again",
            )
        return memoryview(data)[:length]

    def _embedded(self, uri: str) -> bytes:
        if uri not in self._sources:
            head, comma, body = uri.partition(",")
            if not comma or not head.lower().endswith(";base64"):
                raise self.error("a buffer is a data URI that is not base64")
            try:
                self._sources[uri] = base64.b64decode(body, validate=True)
            except (binascii.Error, ValueError) as error:
                raise self.error("a buffer is a data URI whose base64 is damaged") from error
        return self._sources[uri]

    def _external(self, uri: str) -> bytes:
        """Return a file beside or below the .gltf; never one outside of its folder, through a link either."""
        refused = self.error(
            f"a buffer is {uri[:60]!a}, which is not a file in its folder",
            "put all files of it into one folder, or export it as .glb",
        )
        name = unquote(uri)
        parts = PurePosixPath(name).parts
        if not name or name.startswith("/") or ".." in parts or any(char in name for char in ":\\\0\n\r"):
            raise refused
        try:
            folder = self.path.resolve().parent
            path = (self.path.parent / name).resolve()
        except (OSError, ValueError, RuntimeError) as error:
            raise refused from error
        if not path.is_relative_to(folder):
            raise refused
        if str(path) not in self._sources:
            named = existing_file(self.path.parent / name, f"a buffer of {self.path}", "copy it there")
            self._sources[str(path)] = read_bytes(named)
        return self._sources[str(path)]


def extension(item: dict[str, Any], name: str) -> dict[str, Any] | None:
    """Return an extension of an object of the JSON, if it has it."""
    extensions = item.get("extensions")
    value = extensions.get(name) if isinstance(extensions, dict) else None
    return value if isinstance(value, dict) else None


def read_document(path: str | Path) -> GltfDocument:
    """Open a .glb or .gltf file; which of the two is seen from its first bytes."""
    path = existing_file(path, "a glTF file (.glb or .gltf)")
    data = read_bytes(path)
    text, binary = _chunks(path, data) if data[:4] == MAGIC else (data, None)
    try:
        root = json.loads(text, parse_constant=_no_constant)
    except (ValueError, RecursionError) as error:
        what = "is not glTF: its JSON is damaged" if text else "is empty"
        raise FileFormatError(path, what, "copy or export it again") from error
    asset = root.get("asset") if isinstance(root, dict) else None
    version = asset.get("version") if isinstance(asset, dict) else None
    if not isinstance(version, str) or not version.startswith("2"):
        problem = "is not glTF 2" if version is None else "is glTF of a version other than 2"
        raise FileFormatError(path, problem, "export it as glTF 2.0")
    return GltfDocument(path, root, binary)


def _chunks(path: Path, data: bytes) -> tuple[bytes, memoryview | None]:
    """Return the JSON and the binary chunk of a .glb file."""
    if len(data) < HEADER.size:
        raise FileFormatError(path, "ends within its header", "the file is cut short; copy it again")
    _, version, length = HEADER.unpack_from(data)
    if version != 2:
        raise FileFormatError(path, "is binary glTF of a version other than 2", "export it as glTF 2.0")
    if length != len(data):
        raise FileFormatError(
            path,
            f"has {counted(len(data), 'byte')}, but its header says {length}",
            "the file is cut short or damaged; copy it again",
        )
    chunks: list[tuple[bytes, memoryview]] = []
    place = HEADER.size
    while place < length:
        if place + CHUNK.size > length:
            raise FileFormatError(path, "ends within the header of a chunk", _DAMAGED)
        size, kind = CHUNK.unpack_from(data, place)
        place += CHUNK.size
        if place + size > length:
            raise FileFormatError(path, "has a chunk that reaches beyond its end", _DAMAGED)
        if len(chunks) < 2:  # others are of extensions, and to be ignored
            chunks.append((kind, memoryview(data)[place : place + size]))
        place += size
    if not chunks or chunks[0][0] != JSON_CHUNK:
        raise FileFormatError(path, "does not begin with JSON", _DAMAGED)
    binary = chunks[1][1] if len(chunks) > 1 and chunks[1][0] == BINARY_CHUNK else None
    return bytes(chunks[0][1]), binary


def _no_constant(name: str) -> float:
    raise ValueError(f"{name} is not JSON")
