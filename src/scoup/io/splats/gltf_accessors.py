"""Accessors of glTF files: typed columns in their buffers."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from scoup.io.splats.gltf_document import GltfDocument

Integers = Literal["none", "normalised", "any"]
"""Which integers an attribute may be stored as: none, those that mean -1..1 or 0..1, or plain ones too."""

BYTE, UNSIGNED_BYTE, SHORT, UNSIGNED_SHORT, FLOAT = 5120, 5121, 5122, 5123, 5126
_COMPONENTS = {
    BYTE: np.dtype("i1"),
    UNSIGNED_BYTE: np.dtype("u1"),
    SHORT: np.dtype("<i2"),
    UNSIGNED_SHORT: np.dtype("<u2"),
    FLOAT: np.dtype("<f4"),
}
_WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}


def accessor_count(document: GltfDocument, index: Any, what: str) -> int:
    """Return number of rows that an accessor says it has; nothing is read."""
    entry = document.entry("accessors", index, what)
    return document.whole(entry.get("count"), f"the count of {what}", low=1)


def _raw_accessor(document: GltfDocument, index: Any, kind: str, what: str) -> tuple[np.ndarray, bool]:
    """Return a column [N, width] as it is in its buffer, a view of it, and whether its integers are normalised;
    ``kind`` is the type of the accessor, such as VEC3, ``what`` its name in messages."""
    entry = document.entry("accessors", index, what)
    if entry.get("type") != kind:
        raise document.error(f"{what} is not of type {kind}")
    component = entry.get("componentType")
    dtype = _COMPONENTS.get(component) if isinstance(component, int) else None
    if dtype is None:
        raise document.error(f"{what} has a component type that attributes cannot have")
    if "sparse" in entry or "bufferView" not in entry:
        raise document.error(f"{what} is a sparse accessor, which is not read", "export it without them")
    count = accessor_count(document, index, what)
    offset = document.whole(entry.get("byteOffset"), f"the offset of {what}", default=0)
    data, stride = document.view(entry["bufferView"], what)
    width = _WIDTHS[kind]
    size = width * dtype.itemsize
    stride = stride or size
    if stride < size:
        raise document.error(f"the rows of {what} overlap")
    if offset + stride * (count - 1) + size > len(data):
        raise document.error(f"{what} reaches beyond its buffer view")
    rows = np.ndarray((count, width), dtype, data, offset, (stride, dtype.itemsize))
    return rows, entry.get("normalized") is True


def read_accessor(
    document: GltfDocument, index: Any, kind: str, what: str, integers: Integers = "none"
) -> np.ndarray:
    """Return the values of a column: [N, width] float32; see ``_raw_accessor``."""
    rows, normalised = _raw_accessor(document, index, kind, what)
    if rows.dtype.kind == "f":
        return rows.astype(np.float32)
    if integers == "none" or (integers == "normalised" and not normalised):
        raise document.error(f"{what} is stored as integers of a kind that it cannot have")
    if not normalised:
        return rows.astype(np.float32)
    wide = rows.astype(np.float64) / np.iinfo(rows.dtype).max
    return np.maximum(wide, -1.0).astype(np.float32)
