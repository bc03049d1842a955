"""A glTF file of one primitive, put together: buffer views, accessors, and the two containers."""

from __future__ import annotations

import base64
import json
from typing import Any

import numpy as np

from scoup.base.errors import InputError
from scoup.io.splats.gltf_accessors import FLOAT, UNSIGNED_BYTE, UNSIGNED_SHORT
from scoup.io.splats.gltf_document import BINARY_CHUNK, CHUNK, HEADER, JSON_CHUNK, MAGIC

_ALIGNED = 8  # bytes: more than any column here needs
_VERTICES = 34962  # ARRAY_BUFFER
_TYPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}
_COMPONENTS = {"f4": FLOAT, "u1": UNSIGNED_BYTE, "u2": UNSIGNED_SHORT}
_LARGEST_GLB = 2**32 - 1  # its lengths are 32-bit


class GltfBuilder:
    """Collects the columns of one buffer, with their buffer views and accessors."""

    def __init__(self) -> None:
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []
        self._parts: list[bytes] = []
        self._length = 0

    def add_view(self, data: bytes, **properties: int) -> int:
        """Append bytes at an aligned place; return the index of their buffer view."""
        view = {"buffer": 0, "byteOffset": self._length, "byteLength": len(data), **properties}
        padding = -len(data) % _ALIGNED
        self._parts += [data, bytes(padding)]
        self._length += len(data) + padding
        self.views.append(view)
        return len(self.views) - 1

    def add_attribute(self, rows: np.ndarray, normalised: bool = False, bounds: bool = False) -> int:
        """Append a column [N, width] of vertices; return the index of its accessor.

        Args:
            rows: float32, uint16 or uint8. Rows of less than 4 bytes are padded, as glTF asks of vertices.
            normalised: whether integers mean 0..1.
            bounds: whether to state the smallest and largest values.
        """
        size = rows.shape[1] * rows.itemsize
        stride = size + -size % 4
        padded = np.zeros((len(rows), stride), np.uint8)
        padded[:, :size] = np.ascontiguousarray(rows).view(np.uint8).reshape(len(rows), size)
        view = self.add_view(padded.tobytes(), byteStride=stride, target=_VERTICES)
        accessor: dict[str, Any] = {
            "bufferView": view,
            "componentType": _COMPONENTS[rows.dtype.str[1:]],
            "count": len(rows),
            "type": _TYPES[rows.shape[1]],
        }
        if normalised:
            accessor["normalized"] = True
        if bounds:
            accessor |= {"min": rows.min(0).tolist(), "max": rows.max(0).tolist()}
        self.accessors.append(accessor)
        return len(self.accessors) - 1

    def glb(self, root: dict[str, Any]) -> list[bytes]:
        """Return the parts of a .glb file; ``root`` is its JSON without buffers, views and accessors."""
        text = self._json(root, {"byteLength": self._length})
        text += b" " * (-len(text) % 4)
        total = HEADER.size + 2 * CHUNK.size + len(text) + self._length
        if total > _LARGEST_GLB:
            raise InputError("a .glb file cannot be larger than 4 GiB; write a PLY instead")
        header = HEADER.pack(MAGIC, 2, total) + CHUNK.pack(len(text), JSON_CHUNK)
        return [header, text, CHUNK.pack(self._length, BINARY_CHUNK), *self._parts]

    def gltf(self, root: dict[str, Any]) -> list[bytes]:
        """Return the one part of a .gltf file with its buffer inside; see ``glb``."""
        body = base64.b64encode(b"".join(self._parts)).decode()
        uri = f"data:application/octet-stream;base64,{body}"
        return [self._json(root, {"byteLength": self._length, "uri": uri})]

    def _json(self, root: dict[str, Any], buffer: dict[str, Any]) -> bytes:
        whole = {**root, "accessors": self.accessors, "bufferViews": self.views, "buffers": [buffer]}
        return json.dumps(whole, separators=(",", ":"), allow_nan=False).encode()
