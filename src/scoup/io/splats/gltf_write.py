"""A glTF file of one primitive, written: Gaussians by KHR_gaussian_splatting, and their classes by EXT_mesh_features,
with names in a table of EXT_structural_metadata."""

from __future__ import annotations

import base64
import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from torch import Tensor

from scoup.base import InputError, ScoupWarning, atomic_file
from scoup.io.splats.activation import finite_arrays
from scoup.io.splats.axes import Axis, Columns, half_turn, upright
from scoup.io.splats.gltf_document import (
    BINARY_CHUNK,
    CHUNK,
    COMPONENTS,
    DEFAULTS,
    HEADER,
    JSON_CHUNK,
    MAGIC,
    SH_DEGREE,
    SPLATS,
    TYPES,
    sh_names,
)
from scoup.scene import SH_C0, Gaussians

AXIS: Axis = "z"
FEATURES, METADATA = "EXT_mesh_features", "EXT_structural_metadata"
_CLASS, _LABEL = "gaussian_class", "label"  # of the rows of the table of names, and of what they are
_ALIGNED = 8  # bytes: more than any column here needs
_VERTICES = 34962  # ARRAY_BUFFER
_LARGEST_GLB = 2**32 - 1  # its lengths are 32-bit


def write_gltf(
    gaussians: Gaussians,
    path: str | Path,
    overwrite: bool = False,
    ids: Tensor | None = None,
    names: tuple[str, ...] = (),
) -> None:
    """Write a .glb file, or a .gltf file with its buffer inside.

    All float32 values are kept bit by bit, but for what glTF does not allow: quaternions are normalised, opacities
    clipped to 0..1, scales made positive. Coefficients of SH above degree 3 are left out, with a warning. Axes are
    turned to those of glTF (left, up, forward) by signs (``axes``). The node has the frame of the world: it is upright
    and in metres.

    Args:
        gaussians: at least one; rows that are not finite are refused.
        ids: [N] integers on the CPU, the class of each, for viewers that style by class: the position of a name in
            ``names``; -1 for none of them.
        names: C names of classes, at least one; none is empty.
    """
    path = Path(path)
    if not len(gaussians):
        raise InputError(f"{path}: there are no Gaussians to write")
    arrays = half_turn(finite_arrays(gaussians, path), AXIS)
    if gaussians.sh_degree > SH_DEGREE:
        message = f"{path}: glTF has spherical harmonics up to degree {SH_DEGREE}; higher ones are omitted"
        warnings.warn(message, ScoupWarning, stacklevel=2)
        arrays["sh"] = arrays["sh"][:, : (SH_DEGREE + 1) ** 2]
    builder = _Builder()
    root = _root(builder, {name: array.astype(np.float32) for name, array in arrays.items()})
    matrix = np.eye(4)
    matrix[:3, :3] = (gaussians.world.metres_per_unit or 1.0) * upright(gaussians.world, AXIS)
    if (matrix != np.eye(4)).any():
        root["nodes"][0]["matrix"] = matrix.T.ravel().tolist()  # column by column
    if ids is not None:
        _add_features(builder, root, ids.numpy(), names)
    parts = builder.gltf(root) if path.suffix.lower() == ".gltf" else builder.glb(root)
    with atomic_file(path, overwrite) as stream:
        stream.writelines(parts)


def _root(builder: _Builder, arrays: Columns) -> dict[str, Any]:
    """Return the JSON of one primitive, whose columns go to ``builder``."""
    sh, opacities = arrays["sh"], arrays["opacities"][:, None]
    attributes = {
        "POSITION": builder.add_attribute(arrays["means"], bounds=True),
        "COLOR_0": builder.add_attribute(_fallback(sh[:, 0], opacities), normalised=True),
        f"{SPLATS}:ROTATION": builder.add_attribute(np.roll(arrays["quats"], -1, axis=1)),
        f"{SPLATS}:SCALE": builder.add_attribute(arrays["scales"]),
        f"{SPLATS}:OPACITY": builder.add_attribute(opacities),
    }
    for index, name in enumerate(sh_names(round(sh.shape[1] ** 0.5) - 1)):
        attributes[name] = builder.add_attribute(sh[:, index])
    return {
        "asset": {"version": "2.0", "generator": "SCOUP"},
        "extensionsUsed": [SPLATS],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [
            {"primitives": [{"attributes": attributes, "mode": 0, "extensions": {SPLATS: DEFAULTS.copy()}}]}
        ],
    }


def _fallback(base: np.ndarray, opacities: np.ndarray) -> np.ndarray:
    """Return [N, 4] uint16 colour of SH degree 0 in linear RGB, and opacity, for viewers that show points only."""
    with np.errstate(all="ignore"):
        encoded = (base.astype(np.float64) * SH_C0 + 0.5).clip(0.0, 1.0)
    linear = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    return np.round(np.concatenate([linear, opacities], axis=1) * 65_535).astype(np.uint16)


def _add_features(builder: _Builder, root: dict[str, Any], ids: np.ndarray, classes: tuple[str, ...]) -> None:
    """Add the classes [N] of Gaussians to the JSON of ``_root``."""
    count, names = len(classes), [name.encode() for name in classes]
    # Of the smallest type for all numbers; the number of classes means none of them.
    dtype = np.uint8 if count <= 255 else np.uint16 if count <= 65_535 else np.float32
    column = np.where(ids < 0, count, ids).astype(dtype)[:, None]
    primitive = root["meshes"][0]["primitives"][0]
    primitive["attributes"]["_FEATURE_ID_0"] = builder.add_attribute(column)
    stored = {"attribute": 0, "featureCount": count, "label": _LABEL, "nullFeatureId": count}
    primitive["extensions"][FEATURES] = {"featureIds": [{**stored, "propertyTable": 0}]}
    offsets = np.cumsum([0, *map(len, names)]).astype("<u4")
    counts = np.bincount(ids[ids >= 0], minlength=count).astype("<u4")
    values, starts, of_each = map(builder.add_view, (b"".join(names), offsets.tobytes(), counts.tobytes()))
    properties = {
        "name": {"type": "STRING", "required": True, "description": "Name of the class"},
        "count": {
            "type": "SCALAR",
            "componentType": "UINT32",
            "required": True,
            "description": "Number of its Gaussians",
        },
    }
    table = {
        "name": _LABEL,
        "class": _CLASS,
        "count": count,
        "properties": {
            "name": {"values": values, "stringOffsets": starts, "stringOffsetType": "UINT32"},
            "count": {"values": of_each},
        },
    }
    schema = {"id": "scoup_classes", "classes": {_CLASS: {"properties": properties}}}
    root["extensions"] = {METADATA: {"schema": schema, "propertyTables": [table]}}
    root["extensionsUsed"] = [SPLATS, FEATURES, METADATA]


class _Builder:
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
        """Append a column [N, width] of vertices, float32, uint16 or uint8; return the index of its accessor. Rows of
        less than 4 bytes are padded, as glTF asks of vertices. ``normalised`` integers mean 0..1."""
        size = rows.shape[1] * rows.itemsize
        stride = size + -size % 4
        padded = np.zeros((len(rows), stride), np.uint8)
        padded[:, :size] = np.ascontiguousarray(rows).view(np.uint8).reshape(len(rows), size)
        view = self.add_view(padded.tobytes(), byteStride=stride, target=_VERTICES)
        accessor: dict[str, Any] = {
            "bufferView": view,
            "componentType": COMPONENTS[rows.dtype.str[1:]],
            "count": len(rows),
            "type": TYPES[rows.shape[1]],
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
        body = base64.b64encode(b"".join(self._parts)).decode()
        uri = f"data:application/octet-stream;base64,{body}"
        return [self._json(root, {"byteLength": self._length, "uri": uri})]

    def _json(self, root: dict[str, Any], buffer: dict[str, Any]) -> bytes:
        whole = {**root, "accessors": self.accessors, "bufferViews": self.views, "buffers": [buffer]}
        return json.dumps(whole, separators=(",", ":"), allow_nan=False).encode()
