"""Gaussians in glTF files (.glb, .gltf): KHR_gaussian_splatting in its ratified form, plain or as SPZ.

Scales and opacities are linear in the file, quaternions x, y, z, w, and one attribute holds one SH coefficient.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

from scoup.base.errors import ScoupWarning
from scoup.base.json_node import JsonNode
from scoup.io.splats.activation import keep_finite, unit_quats
from scoup.io.splats.axes import Columns, half_turn
from scoup.io.splats.gltf_document import (
    DEFAULTS,
    SH_DEGREE,
    SPLATS,
    GltfDocument,
    read_document,
    sh_names,
)
from scoup.io.splats.gltf_write import AXIS, FEATURES, METADATA, write_gltf
from scoup.io.splats.rotation import rotated_quats, rotated_sh
from scoup.io.splats.splat_format import SplatFormat
from scoup.io.splats.spz import spz_columns
from scoup.scene.gaussians import Gaussians
from scoup.scene.rotations import rotation_matrices

_SPZ = f"{SPLATS}_compression_spz"  # also with a version of .spz behind it
_UNDERSTOOD = {SPLATS, FEATURES, METADATA, "KHR_mesh_quantization"}
# What they concern are meshes beside the Gaussians.
_OF_SURFACES = ("KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_lights_")
# Bytes of Gaussians for a byte of the file, plain and as SPZ; beyond it nodes repeat a mesh to no end.
_REPEATS, _REPEATS_PACKED = 32, 500
_UNIFORM = 1e-4  # of the ratio of two scales: what float32 matrices stay within after several products
_EXPORT_PLAIN = "export it uncompressed (with KHR_gaussian_splatting alone), or as PLY"
_APPLY = "apply the transform of the node in the program that made the file, and export it again"


def read_gltf(path: str | Path) -> Gaussians:
    """Read the Gaussians of a .glb or .gltf file, of all nodes of its scene.

    The world's axes (left, up, forward) are turned to those of 3DGS by signs (``axes``).

    Buffers may be inside, or in files beside or below it. Values that no node transforms are kept bit by bit.

    Warns:
        ScoupWarning: rows with values that are not finite (or no rotation) were dropped, or the file asks for
            another kernel, colour space, projection or sorting than Gaussians here have.
    """
    document = read_document(path)
    for name in _names(document.root, "extensionsRequired"):
        if name not in _UNDERSTOOD and not name.startswith((_SPZ, *_OF_SURFACES)):
            raise document.error(f"needs the extension {name[:60]!a}, which is not read", _EXPORT_PLAIN)
    packed = any(name.startswith(_SPZ) for name in _names(document.root, "extensionsUsed"))
    most = _REPEATS_PACKED if packed else _REPEATS
    placed: list[Columns] = []
    local: dict[str, Columns] = {}
    total = 0
    for primitive, similarity in _placed_splats(document):
        if primitive.place not in local:
            local[primitive.place] = _read_primitive(document, primitive)
        columns = local[primitive.place]
        total += sum(column.nbytes for column in columns.values())
        if total > most * document.data_bytes:
            raise document.error("repeats its Gaussians far too often", "apply its instances, or remove them")
        placed.append(columns if similarity is None else similarity.moved(columns))
    if not placed:
        raise _no_gaussians(document)
    bases = max(columns["sh"].shape[1] for columns in placed)  # primitives may have different degrees
    for columns in placed:
        columns["sh"] = np.pad(columns["sh"], ((0, 0), (0, bases - columns["sh"].shape[1]), (0, 0)))
    joined = {name: np.concatenate([columns[name] for columns in placed]) for name in placed[0]}
    return keep_finite(**half_turn(joined, AXIS), source=str(document.path))[0]


def _no_gaussians(document: GltfDocument) -> Exception:
    meshes = document.root.get("meshes")
    if meshes.value is not None and any(map(_splat_primitives, meshes.items())):
        return document.error("no node of its scene contains its Gaussians", "add them to the scene")
    return document.error(
        f"contains no Gaussians ({SPLATS}), but a mesh or nothing",
        "export the trained splat, as PLY or with that extension",
    )


def _names(node: JsonNode, key: str) -> list[str]:
    return [item.text() for item in _nodes(node, key)]


def _nodes(node: JsonNode, key: str) -> list[JsonNode]:
    """Return the items of a list that may be missing."""
    items = node.get(key)
    return [] if items.value is None else items.items()


# ---- nodes: the way from the frames of primitives to that of the world


@dataclass(frozen=True)
class _Similarity:
    """x -> scale * rotation @ x + translation; all float64."""

    scale: float
    rotation: np.ndarray  # [3, 3]
    translation: np.ndarray  # [3]

    def moved(self, columns: Columns) -> Columns:
        """Return the values of a primitive in the frame of the world, computed in float64 and rounded once."""
        with np.errstate(all="ignore"):
            means = columns["means"].astype(np.float64) @ (self.scale * self.rotation).T
            return {
                "means": (means + self.translation).astype(np.float32),
                "quats": rotated_quats(columns["quats"], self.rotation),
                "scales": (columns["scales"].astype(np.float64) * self.scale).astype(np.float32),
                "opacities": columns["opacities"],
                "sh": rotated_sh(columns["sh"], self.rotation),
            }


def _placed_splats(document: GltfDocument) -> Iterator[tuple[JsonNode, _Similarity | None]]:
    """Yield the primitives with Gaussians of the scene, each with its way to the world (None where it is there
    already).

    A mesh that several nodes use comes once for each of them.
    """
    waiting = [(index, np.eye(4)) for index in reversed(_roots(document))]
    seen: set[str] = set()
    while waiting:
        index, above = waiting.pop()
        node = document.entry("nodes", index)
        if node.place in seen:
            raise document.error(f"{node.place} has several parents, or is below itself")
        seen.add(node.place)
        with np.errstate(all="ignore"):
            matrix = above @ _own_matrix(document, node)
        if not np.isfinite(matrix).all():
            raise document.error(f"the transform of {node.place} is not finite")
        if node.get("mesh").value is not None:
            for primitive in _splat_primitives(document.entry("meshes", node.get("mesh"))):
                yield primitive, _similarity(document, matrix, node.place)
        waiting += [(child, matrix) for child in reversed(_nodes(node, "children"))]


def _splat_primitives(mesh: JsonNode) -> list[JsonNode]:
    """Return the primitives of a mesh that hold Gaussians."""
    return [
        item
        for item in mesh.get("primitives").items()
        if isinstance(extensions := item.get("extensions").value, dict) and SPLATS in extensions
    ]


def _roots(document: GltfDocument) -> list[JsonNode]:
    """Return the top nodes of the scene that is shown, by their indices; without scenes, the nodes that have no
    parent."""
    if document.root.get("scenes").value:
        return _nodes(document.entry("scenes", document.root.get("scene"), default=0), "nodes")
    nodes = _nodes(document.root, "nodes")
    below = {child.whole() for node in nodes for child in _nodes(node, "children")}
    return [replace(node, value=index) for index, node in enumerate(nodes) if index not in below]


def _own_matrix(document: GltfDocument, node: JsonNode) -> np.ndarray:
    """Return [4, 4] float64 of a node's matrix, or of its translation, rotation and scale."""

    def numbers(name: str, *default: float) -> np.ndarray:
        given = node.get(name)
        return np.array(default) if given.value is None else given.numbers(len(default))

    if node.get("matrix").value is not None:
        matrix = node.get("matrix").numbers(16).reshape(4, 4).T
        if matrix[3].tolist() != [0, 0, 0, 1]:
            raise document.error(f"the matrix of {node.place} does not end with 0, 0, 0, 1")
        return matrix
    matrix = np.eye(4)
    quat = np.roll(numbers("rotation", 0.0, 0.0, 0.0, 1.0), 1)
    with np.errstate(all="ignore"):
        if not 0 < np.linalg.norm(quat) < np.inf:
            raise document.error(f"the rotation of {node.place} is not a quaternion")
        rotation = rotation_matrices(torch.from_numpy(quat)[None])[0].numpy()
        matrix[:3, :3] = rotation * numbers("scale", 1.0, 1.0, 1.0)
    matrix[:3, 3] = numbers("translation", 0.0, 0.0, 0.0)
    return matrix


def _similarity(document: GltfDocument, matrix: np.ndarray, place: str) -> _Similarity | None:
    if (matrix == np.eye(4)).all():
        return None  # values are kept, bit by bit
    largest = float(np.abs(matrix[:3, :3]).max())
    left, sizes, right = np.linalg.svd(matrix[:3, :3] / (largest or 1.0))
    if sizes[0] >= sizes[2] * (1 + _UNIFORM):  # so are all zeros
        raise document.error(f"{place} stretches, shears or flattens its Gaussians", _APPLY)
    rotation = left @ right
    if np.linalg.det(rotation) < 0:
        raise document.error(f"{place} mirrors its Gaussians", _APPLY)
    return _Similarity(float(sizes.mean()) * largest, rotation, matrix[:3, 3])


# ---- the Gaussians of one primitive, in its own frame


def _read_primitive(document: GltfDocument, primitive: JsonNode) -> Columns:
    """Return the values of a primitive."""
    if primitive.get("mode").value != 0:
        raise document.error("its Gaussians are not points (mode 0)", "export it again")
    splats = primitive.get("extensions").get(SPLATS)
    for name, usual in DEFAULTS.items():
        if (given := splats.get(name).value) not in (None, usual):
            warnings.warn(
                f"{document.path}: its {name} is {ascii(given)[:60]}; it is read as if it were {usual}",
                ScoupWarning,
                stacklevel=4,
            )
    inner = splats.get("extensions")
    for name in inner.object() if inner.value is not None else ():
        if name.startswith(_SPZ):
            data, _ = document.view(inner.get(name).get("bufferView"))
            return _packed_columns(document, bytes(data))
        if "compression" in name:
            raise document.error(f"its Gaussians are compressed ({name[:60]!a})", _EXPORT_PLAIN)
    attributes = primitive.get("attributes")

    def column(name: str, kind: str, plain: bool = False) -> np.ndarray:
        index = attributes.get(name)
        if index.value is None:
            remedy = "export it again with the ratified extension"
            raise document.error(f"its Gaussians have no {name}", remedy)
        return document.column(index, kind, plain)

    degrees = [
        degree
        for degree in range(1, SH_DEGREE + 1)
        if any(name.startswith(f"{SPLATS}:SH_DEGREE_{degree}_") for name in attributes.object())
    ]
    coefficients = [column(name, "VEC3") for name in sh_names(max(degrees, default=0))]
    columns = {
        "means": column("POSITION", "VEC3", plain=True),
        "quats": unit_quats(np.roll(column(f"{SPLATS}:ROTATION", "VEC4"), 1, axis=1)),
        "scales": np.abs(column(f"{SPLATS}:SCALE", "VEC3", plain=True)),
        "opacities": column(f"{SPLATS}:OPACITY", "SCALAR")[:, 0].clip(0.0, 1.0),
    }
    if len({len(each) for each in (*columns.values(), *coefficients)}) > 1:
        raise document.error("the attributes of its Gaussians have different counts")
    return {**columns, "sh": np.stack(coefficients, axis=1)}


def _packed_columns(document: GltfDocument, content: bytes) -> Columns:
    """Return the values of a primitive that is a .spz file."""
    _, columns = spz_columns(document.path, content)
    if columns["sh"].shape[1] > (SH_DEGREE + 1) ** 2:
        problem = f"has SH of a degree above {SH_DEGREE}, which glTF does not know"
        raise document.error(problem, _EXPORT_PLAIN)
    return half_turn(columns, AXIS)  # to left, up, forward


FORMAT = SplatFormat("glTF", (".glb", ".gltf"), read_gltf, write_gltf, axis=AXIS, in_scenes=False)
