"""Gaussians in glTF files (.glb, .gltf): KHR_gaussian_splatting in its ratified form, plain or (read only) as SPZ.

Scales and opacities are linear in the file, quaternions x, y, z, w, and one attribute holds one SH coefficient.
"""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import torch

from scoup.base.atomic import atomic_file
from scoup.base.errors import InputError, ScoupWarning
from scoup.io.splats.activation import keep_finite, linear_arrays
from scoup.io.splats.axes import Axis, Columns, half_turn
from scoup.io.splats.gltf_document import GltfDocument, read_document
from scoup.io.splats.gltf_features import (
    FEATURES,
    METADATA,
    GaussianFeatures,
    features_json,
    metadata_json,
    stored_ids,
    table_columns,
)
from scoup.io.splats.gltf_nodes import SPLATS, placed_splats, splat_primitives
from scoup.io.splats.gltf_primitive import (
    DEFAULTS,
    EXPORT_PLAIN,
    SH_DEGREE,
    SPZ,
    read_primitive,
    sh_names,
    transformed,
)
from scoup.io.splats.gltf_write import GltfBuilder
from scoup.io.splats.splat_format import SplatFormat
from scoup.scene.gaussians import SH_C0, Gaussians

_AXIS: Axis = "z"
_UNDERSTOOD = {SPLATS, FEATURES, METADATA, "KHR_mesh_quantization"}
# What they concern are meshes beside the Gaussians.
_OF_SURFACES = ("KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_lights_")
# Bytes of Gaussians for a byte of the file, plain and as SPZ; beyond it nodes repeat a mesh to no end.
_REPEATS, _REPEATS_PACKED = 32, 500


def read_gltf(path: str | Path) -> Gaussians:
    """Read the Gaussians of a .glb or .gltf file, of all nodes of its scene.

    The world's axes (left, up, forward) are turned to those of 3DGS by signs (``axes``).

    Buffers may be inside, or in files beside or below it. Values that no node transforms are kept bit by bit.

    Warns:
        ScoupWarning: rows with values that are not finite (or no rotation) were dropped, or the file asks for
            another kernel, colour space, projection or sorting than Gaussians here have.
    """
    document = read_document(path)
    _check_extensions(document)
    primitives: list[Columns] = []
    local: dict[int, Columns] = {}
    total = 0
    packed = any(name.startswith(SPZ) for name in document.names("extensionsUsed"))
    most = _REPEATS_PACKED if packed else _REPEATS
    for primitive, similarity in placed_splats(document):
        if id(primitive) not in local:
            local[id(primitive)] = read_primitive(document, primitive)
        columns = local[id(primitive)]
        total += sum(column.nbytes for column in columns.values())
        if total > most * document.data_bytes:
            raise document.error("repeats its Gaussians far too often", "apply its instances, or remove them")
        primitives.append(columns if similarity is None else transformed(columns, similarity))
    if not primitives:
        raise _no_gaussians(document)
    bases = max(columns["sh"].shape[1] for columns in primitives)
    for place, columns in enumerate(primitives):  # primitives may have different degrees
        missing = bases - columns["sh"].shape[1]
        if missing:
            primitives[place] = {**columns, "sh": np.pad(columns["sh"], ((0, 0), (0, missing), (0, 0)))}
    joined = {name: np.concatenate([columns[name] for columns in primitives]) for name in primitives[0]}
    return keep_finite(**half_turn(joined, _AXIS), source=str(document.path))[0]


def write_gltf(
    gaussians: Gaussians,
    path: str | Path,
    overwrite: bool = False,
    features: GaussianFeatures | None = None,
) -> None:
    """Write a .glb file, or a .gltf file with its buffer inside.

    All float32 values are kept bit by bit, but for what glTF does not allow: quaternions are normalised, opacities
    clipped to 0..1, scales made positive. Coefficients of SH above degree 3 and rows that are not finite are left
    out. Axes are turned to those of glTF (left, up, forward) by signs (``axes``).

    Args:
        gaussians: at least one.
        features: the class of each, for viewers that style by class.

    Warns:
        ScoupWarning: rows or coefficients were left out.
    """
    path = Path(path)
    if path.suffix.lower() not in (".glb", ".gltf"):
        raise InputError(f"{path}: glTF files end in .glb or .gltf; use such a name")
    if features is not None and len(features.ids) != len(gaussians):
        raise InputError(f"features are of {len(features.ids):,} Gaussians, not of {len(gaussians):,}")
    finite, kept = keep_finite(**half_turn(_writable(gaussians, path), _AXIS), source=str(path))
    if not len(finite):
        raise InputError(f"{path}: there are no Gaussians to write")
    if features is not None:
        features = GaussianFeatures(features.ids[torch.from_numpy(kept)], features.names, features.label)
    builder = GltfBuilder()
    root = _root(builder, finite, features)
    parts = builder.glb(root) if path.suffix.lower() == ".glb" else builder.gltf(root)
    with atomic_file(path, overwrite) as stream:
        stream.writelines(parts)


def _check_extensions(document: GltfDocument) -> None:
    for name in document.names("extensionsRequired"):
        if name not in _UNDERSTOOD and not name.startswith((SPZ, *_OF_SURFACES)):
            raise document.error(f"needs the extension {name[:60]!a}, which is not read", EXPORT_PLAIN)


def _no_gaussians(document: GltfDocument) -> Exception:
    if any(splat_primitives(document, mesh) for mesh in range(len(document.entries("meshes")))):
        return document.error("no node of its scene contains its Gaussians", "add them to the scene")
    return document.error(
        f"contains no Gaussians ({SPLATS}), but a mesh or nothing",
        "export the trained splat, as PLY or with that extension",
    )


def _writable(gaussians: Gaussians, path: Path) -> Columns:
    values = linear_arrays(gaussians)
    bases = (SH_DEGREE + 1) ** 2
    if values["sh"].shape[1] > bases:
        warnings.warn(
            f"{path}: glTF has spherical harmonics up to degree {SH_DEGREE}; higher ones are omitted",
            ScoupWarning,
            stacklevel=4,
        )
    return {**values, "sh": values["sh"][:, :bases]}


def _root(builder: GltfBuilder, gaussians: Gaussians, features: GaussianFeatures | None) -> dict[str, Any]:
    """Return the JSON of one primitive, whose columns go to ``builder``."""
    sh, opacities = gaussians.sh.numpy(), gaussians.opacities.numpy()[:, None]
    attributes = {
        "POSITION": builder.add_attribute(gaussians.means.numpy(), bounds=True),
        "COLOR_0": builder.add_attribute(_fallback(sh[:, 0], opacities), normalised=True),
        f"{SPLATS}:ROTATION": builder.add_attribute(np.roll(gaussians.quats.numpy(), -1, axis=1)),
        f"{SPLATS}:SCALE": builder.add_attribute(gaussians.scales.numpy()),
        f"{SPLATS}:OPACITY": builder.add_attribute(opacities),
    }
    for index, name in enumerate(sh_names(gaussians.sh_degree)):
        attributes[name] = builder.add_attribute(sh[:, index])
    primitive: dict[str, Any] = {"attributes": attributes, "mode": 0, "extensions": {SPLATS: dict(DEFAULTS)}}
    root = {
        "asset": {"version": "2.0", "generator": "SCOUP"},
        "extensionsUsed": [SPLATS],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}],
    }
    if features is not None:
        attributes["_FEATURE_ID_0"] = builder.add_attribute(stored_ids(features))
        primitive["extensions"][FEATURES] = features_json(features)
        names, offsets, counts = (builder.add_view(data) for data in table_columns(features))
        root["extensions"] = {METADATA: metadata_json(features, (names, offsets, counts))}
        root["extensionsUsed"] = [SPLATS, FEATURES, METADATA]
    return root


def _fallback(base: np.ndarray, opacities: np.ndarray) -> np.ndarray:
    """Return [N, 4] uint16 colour of SH degree 0 in linear RGB, and opacity, for viewers that show points only."""
    with np.errstate(all="ignore"):
        encoded = (base.astype(np.float64) * SH_C0 + 0.5).clip(0.0, 1.0)
    linear = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    return np.round(np.concatenate([linear, opacities], axis=1) * 65_535).astype(np.uint16)


FORMAT = SplatFormat("glTF", (".glb", ".gltf"), read_gltf, write_gltf, axis=_AXIS, in_scenes=False)
