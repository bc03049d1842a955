"""Classes of Gaussians in glTF files: EXT_mesh_features, with names in a table of EXT_structural_metadata."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from scoup.base.errors import InputError

FEATURES, METADATA = "EXT_mesh_features", "EXT_structural_metadata"
CLASS = "gaussian_class"  # of the rows of the table of names, in its schema
MOST_NAMES = 2**24 - 1  # the number after the last is still a whole float32

_IDENTIFIER = re.compile(r"[a-zA-Z_][a-zA-Z0-9_]*")


@dataclass(frozen=True, eq=False)
class GaussianFeatures:
    """The class of every Gaussian, as glTF viewers find it; written, and not read."""

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
