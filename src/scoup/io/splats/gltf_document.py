"""glTF files as they are stored: the JSON of a .gltf or .glb file and the columns of its buffers, all checked."""

from __future__ import annotations

import base64
import binascii
import json
import struct
from dataclasses import replace
from pathlib import Path
from urllib.parse import unquote

import numpy as np

from scoup.base import FileFormatError, JsonNode, counted, existing_file
from scoup.io.reading import read_bytes

MAGIC = b"glTF"
HEADER, CHUNK = struct.Struct("<4sII"), struct.Struct("<I4s")
JSON_CHUNK, BINARY_CHUNK = b"JSON", b"BIN\0"
TYPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}
COMPONENTS = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "f4": 5126}
_DAMAGED = "the file is damaged; export it again"

SPLATS = "KHR_gaussian_splatting"
SH_DEGREE = 3  # the highest that the extension knows
DEFAULTS = {
    "kernel": "ellipse",
    "colorSpace": "srgb_rec709_display",
    "projection": "perspective",
    "sortingMethod": "cameraDistance",
}
"""Properties of the extension and the values that they have for Gaussians of 3DGS."""


def sh_names(degree: int) -> list[str]:
    """Return the attributes of all coefficients up to a degree, in our order."""
    return [
        f"{SPLATS}:SH_DEGREE_{level}_COEF_{order}"
        for level in range(degree + 1)
        for order in range(2 * level + 1)
    ]


class GltfDocument:
    """The JSON of a glTF file and its buffers, with the binary chunk of a .glb file; every access is checked."""

    def __init__(self, root: JsonNode, binary: memoryview | None) -> None:
        self.path = root.path
        self.root = root
        self._binary = binary
        self._sources: dict[str, bytes] = {}

    def error(self, problem: str, remedy: str = _DAMAGED) -> FileFormatError:
        return FileFormatError(self.path, problem, remedy)

    def entry(self, name: str, index: JsonNode, default: int | None = None) -> JsonNode:
        """Return the entry of the list ``name`` at the top of the JSON that an index points to."""
        entries, number = self.root.get(name), index.whole(default=default)
        if not isinstance(entries.value, list):
            raise entries.error("a list")
        if number >= len(entries.value):
            raise self.error(f"{index.place} is {number}, but {name} has {len(entries.value)}")
        return replace(entries, value=entries.value[number], place=f"{name}[{number}]")

    @property
    def data_bytes(self) -> int:
        """Return the bytes of buffers opened so far."""
        return (0 if self._binary is None else len(self._binary)) + sum(map(len, self._sources.values()))

    def column(self, index: JsonNode, kind: str, plain: bool = False) -> np.ndarray:
        """Return the values [N, width] float32 of an accessor of this type, such as VEC3. Integers mean -1..1 or 0..1;
        they may mean themselves where ``plain``."""
        accessor = self.entry("accessors", index)
        accessor.get("type").text((kind,))
        component = accessor.get("componentType")
        dtype = next((name for name, code in COMPONENTS.items() if code == component.value), None)
        if dtype is None:
            raise component.error("a component type of attributes")
        if accessor.get("sparse").value is not None or accessor.get("bufferView").value is None:
            problem = f"{index.place} is a sparse accessor, which is not read"
            raise self.error(problem, "export it without them")
        count = accessor.get("count").whole(low=1)
        offset = accessor.get("byteOffset").whole(default=0)
        data, stride = self.view(accessor.get("bufferView"))
        width = next(width for width, name in TYPES.items() if name == kind)
        size = width * np.dtype(dtype).itemsize
        stride = stride or size
        if stride < size:
            raise self.error(f"the rows of {index.place} overlap")
        if offset + stride * (count - 1) + size > len(data):
            raise self.error(f"{index.place} reaches beyond its buffer view")
        rows = np.ndarray((count, width), f"<{dtype}", data, offset, (stride, np.dtype(dtype).itemsize))
        normalised = accessor.get("normalized").value is True
        if dtype == "f4" or (plain and not normalised):
            return rows.astype(np.float32)
        if not normalised:
            raise self.error(f"{index.place} is stored as integers that are not normalised")
        return np.maximum(rows / np.float64(np.iinfo(rows.dtype).max), -1.0).astype(np.float32)

    def view(self, index: JsonNode) -> tuple[memoryview, int]:
        """Return the bytes of a buffer view and its stride (0 where it has none)."""
        view = self.entry("bufferViews", index)
        data = self._buffer(view.get("buffer"))
        offset, length = view.get("byteOffset").whole(default=0), view.get("byteLength").whole(low=1)
        if offset + length > len(data):
            raise self.error(f"{view.place} reaches beyond its buffer")
        return data[offset : offset + length], view.get("byteStride").whole(default=0)

    def _buffer(self, index: JsonNode) -> memoryview:
        buffer = self.entry("buffers", index)
        length, uri = buffer.get("byteLength").whole(low=1), buffer.get("uri")
        if uri.value is not None:
            data = self._source(uri.text())
        elif self._binary is not None and index.value == 0:
            data = self._binary
        else:
            raise self.error(f"{buffer.place} has no data")
        if len(data) < length:
            raise self.error(
                f"{buffer.place} contains {counted(len(data), 'byte')}, but its JSON says {length}",
                "the file is cut short; copy it again",
            )
        return memoryview(data)[:length]

    def _source(self, uri: str) -> bytes:
        if uri not in self._sources:
            is_embedded = uri[:5].lower() == "data:"
            self._sources[uri] = self._embedded(uri) if is_embedded else self._external(uri)
        return self._sources[uri]

    def _embedded(self, uri: str) -> bytes:
        head, _, body = uri.partition(",")
        if not head.lower().endswith(";base64"):
            raise self.error("a buffer is a data URI that is not base64")
        try:
            return base64.b64decode(body, validate=True)
        except (binascii.Error, ValueError) as error:
            raise self.error("a buffer is a data URI whose base64 is damaged") from error

    def _external(self, uri: str) -> bytes:
        """Return a file beside or below the .gltf; never one outside of its folder, through a link either."""
        path = self.path.parent / unquote(uri)
        try:
            is_inside = path.resolve().is_relative_to(self.path.resolve().parent)
        except (OSError, ValueError, RuntimeError):  # a name that no system takes
            is_inside = False
        if not is_inside or any(char in unquote(uri) for char in ":\\\n\r"):
            raise self.error(
                f"a buffer is {uri[:60]!a}, which is not a file in its folder",
                "put all files of it into one folder, or export it as .glb",
            )
        return read_bytes(existing_file(path, f"a buffer of {self.path}", "copy it there"))


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
    return GltfDocument(JsonNode(path, root, _DAMAGED), binary)


def _chunks(path: Path, data: bytes) -> tuple[bytes, memoryview | None]:
    if len(data) < HEADER.size:
        raise FileFormatError(path, "ends within its header", "the file is cut short; copy it again")
    _, version, length = HEADER.unpack_from(data)
    if version != 2:
        raise FileFormatError(path, "is binary glTF of a version other than 2", "export it as glTF 2.0")
    if length != len(data):
        problem = f"has {counted(len(data), 'byte')}, but its header says {length}"
        raise FileFormatError(path, problem, "the file is cut short or damaged; copy it again")
    chunks: list[tuple[bytes, memoryview]] = []
    offset = HEADER.size
    while offset < length and len(chunks) < 2:  # others are of extensions, and to be ignored
        if offset + CHUNK.size > length:
            raise FileFormatError(path, "ends within the header of a chunk", _DAMAGED)
        size, kind = CHUNK.unpack_from(data, offset)
        offset += CHUNK.size
        if offset + size > length:
            raise FileFormatError(path, "has a chunk that reaches beyond its end", _DAMAGED)
        chunks.append((kind, memoryview(data)[offset : offset + size]))
        offset += size
    if not chunks or chunks[0][0] != JSON_CHUNK:
        raise FileFormatError(path, "does not begin with JSON", _DAMAGED)
    binary = chunks[1][1] if len(chunks) > 1 and chunks[1][0] == BINARY_CHUNK else None
    return bytes(chunks[0][1]), binary


def _no_constant(name: str) -> float:
    raise ValueError(f"{name} is not JSON")
