"""Classes of Gaussians in glTF files: EXT_mesh_features, with names in a table of EXT_structural_metadata."""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from torch import Tensor

from scoup.base.errors import InputError
from scoup.io.splats.gltf_accessors import raw_accessor
from scoup.io.splats.gltf_document import GltfDocument, extension

FEATURES, METADATA = "EXT_mesh_features", "EXT_structural_metadata"
CLASS = "gaussian_class"  # of the rows of the table of names, in its schema
MOST_NAMES = 2**24 - 1  # the number after the last is still a whole float32

_IDENTIFIER = re.compile(r"[a-zA-Z_][a-zA-Z0-9_]*")
_OFFSETS = {f"UINT{8 * size}": np.dtype(f"<u{size}") for size in (1, 2, 4, 8)}


@dataclass(frozen=True, eq=False)
class GaussianFeatures:
    """The class of every Gaussian, as glTF viewers find it."""

    ids: Tensor
    """[N] int64 on the CPU, the position of a name in ``names``; -1 for none of them. Any integers are taken."""
    names: tuple[str, ...]
    """C names of classes, at least one; none is empty."""
    label: str = "label"
    """What the classes are called in the file: letters, digits and underscores."""

    def __post_init__(self) -> None:
        ids = torch.as_tensor(self.ids).detach().cpu()
        if ids.dim() != 1 or ids.is_floating_point() or ids.is_complex():
            raise InputError(f"GaussianFeatures.ids is {list(ids.shape)} {ids.dtype}, expected [N] integers")
        object.__setattr__(self, "ids", ids.long())
        object.__setattr__(self, "names", tuple(self.names))
        if not 0 < len(self.names) <= MOST_NAMES or not all(self.names):
            raise InputError(f"GaussianFeatures.names needs 1 to {MOST_NAMES:,} names, none of them empty")
        if len(self.ids) and not (int(self.ids.min()) >= -1 and int(self.ids.max()) < len(self.names)):
            raise InputError(f"GaussianFeatures.ids has values outside of -1 to {len(self.names) - 1}")
        if not _IDENTIFIER.fullmatch(self.label):
            raise InputError(
                f"GaussianFeatures.label is {self.label!r}, expected letters, digits and underscores"
            )


def stored_ids(features: GaussianFeatures) -> np.ndarray:
    """Return [N, 1] of the smallest type for all ids; the number of classes means none of them."""
    count = len(features.names)
    dtype = np.uint8 if count <= 255 else np.uint16 if count <= 65_535 else np.float32
    ids = features.ids.numpy()
    return np.where(ids < 0, count, ids).astype(dtype)[:, None]


def table_columns(features: GaussianFeatures) -> tuple[bytes, bytes, bytes]:
    """Return the names in UTF-8, the offsets of their starts (and of the last end), and the Gaussians of each."""
    names = [name.encode() for name in features.names]
    offsets = np.cumsum([0, *map(len, names)]).astype("<u4")
    ids = features.ids.numpy()
    counts = np.bincount(ids[ids >= 0], minlength=len(names)).astype("<u4")
    return b"".join(names), offsets.tobytes(), counts.tobytes()


def features_json(features: GaussianFeatures) -> dict[str, Any]:
    """Return the extension of a primitive whose attribute _FEATURE_ID_0 holds ``stored_ids``."""
    count = len(features.names)
    ids = {"attribute": 0, "featureCount": count, "label": features.label}
    return {"featureIds": [{**ids, "nullFeatureId": count, "propertyTable": 0}]}


def metadata_json(features: GaussianFeatures, views: tuple[int, int, int]) -> dict[str, Any]:
    """Return the extension of the file; ``views`` are the buffer views of ``table_columns``."""
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
        "name": features.label,
        "class": CLASS,
        "count": len(features.names),
        "properties": {
            "name": {"values": views[0], "stringOffsets": views[1], "stringOffsetType": "UINT32"},
            "count": {"values": views[2]},
        },
    }
    schema = {"id": "scoup_classes", "classes": {CLASS: {"properties": properties}}}
    return {"schema": schema, "propertyTables": [table]}


def primitive_ids(document: GltfDocument, primitive: dict[str, Any], count: int) -> np.ndarray | None:
    """Return [N] int64 ids of a primitive of N = ``count`` Gaussians as they are stored, -1 for none; None if it has
    none.
    """
    feature_set = id_set(document, primitive)
    if feature_set is None:
        return None
    name = f"_FEATURE_ID_{document.whole(feature_set['attribute'], 'the attribute of feature ids')}"
    attributes = primitive.get("attributes")
    index = attributes.get(name) if isinstance(attributes, dict) else None
    rows, normalised = raw_accessor(document, index, "SCALAR", name)
    if normalised or len(rows) != count:
        raise document.error(f"{name} is normalised, or not of as many rows as there are Gaussians")
    ids = rows[:, 0].astype(np.float64)
    limit = document.whole(feature_set.get("featureCount"), "featureCount", low=1)
    null = document.whole(feature_set.get("nullFeatureId"), "nullFeatureId", default=limit)
    valid = (ids >= 0) & (ids < MOST_NAMES + 1) & (ids != null)  # so are no NaNs
    return np.where(valid, ids, -1.0).astype(np.int64)


def id_set(document: GltfDocument, primitive: dict[str, Any]) -> dict[str, Any] | None:
    """Return the first set of ids of a primitive that is stored as an attribute and has a table."""
    sets = (extension(primitive, FEATURES) or {}).get("featureIds", [])
    if not isinstance(sets, list):
        raise document.error("featureIds is not a list")
    for item in sets:
        if isinstance(item, dict) and "attribute" in item and "propertyTable" in item:
            return item
    return None


def table_names(document: GltfDocument, index: Any) -> tuple[str, ...]:
    """Return the names in a property table: its property ``name`` or else the first one that holds texts."""
    tables = (extension(document.root, METADATA) or {}).get("propertyTables")
    number = document.whole(index, "the property table of feature ids")
    if not isinstance(tables, list) or number >= len(tables) or not isinstance(tables[number], dict):
        raise document.error(f"there is no property table {number}")
    table = tables[number]
    count = document.whole(table.get("count"), "the count of a property table", low=1)
    properties = table.get("properties")
    columns = properties if isinstance(properties, dict) else {}
    texts = {key: item for key, item in columns.items() if isinstance(item, dict) and "stringOffsets" in item}
    if not texts:
        raise document.error("its property table contains no names", "add a property of type STRING")
    return _texts(document, texts["name"] if "name" in texts else next(iter(texts.values())), count)


def _texts(document: GltfDocument, column: dict[str, Any], count: int) -> tuple[str, ...]:
    kind = column.get("stringOffsetType", "UINT32")
    dtype = _OFFSETS.get(kind) if isinstance(kind, str) else None
    if dtype is None or "arrayOffsets" in column:
        raise document.error("the names of its property table are stored in a way that is not read")
    data, _ = document.view(column.get("values"), "names")
    places, _ = document.view(column["stringOffsets"], "the offsets of names")
    if (count + 1) * dtype.itemsize > len(places):
        raise document.error("the offsets of names reach beyond their buffer view")
    offsets = np.frombuffer(places, dtype, count + 1)
    if (offsets[1:] < offsets[:-1]).any() or offsets[-1] > len(data):
        raise document.error("the offsets of names do not fit the names")
    try:
        ends = offsets.tolist()
        return tuple(bytes(data[start:end]).decode() for start, end in pairwise(ends))
    except UnicodeDecodeError as error:
        raise document.error("the names of its property table are not UTF-8") from error
