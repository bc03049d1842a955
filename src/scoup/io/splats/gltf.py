"""Gaussians in glTF files (.glb, .gltf): KHR_gaussian_splatting in its ratified form, plain or as SPZ.

Scales and opacities are linear in the file, quaternions x, y, z, w, and one attribute holds one SH coefficient.
"""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from scoup.base import JsonNode, ScoupWarning, WorldFrame
from scoup.io.similarity import similarity_scale
from scoup.io.splats.activation import keep_finite, unit_quats
from scoup.io.splats.axes import Columns, half_turn, turned_direction
from scoup.io.splats.gltf_document import DEFAULTS, SH_DEGREE, SPLATS, GltfDocument, read_document, sh_names
from scoup.io.splats.gltf_write import AXIS, FEATURES, METADATA, write_gltf
from scoup.io.splats.splat_format import SplatFormat
from scoup.io.splats.spz import spz_columns
from scoup.scene import Gaussians, rotation_matrices

_SPZ = f"{SPLATS}_compression_spz"  # also with a version of .spz behind it
_UNDERSTOOD = {SPLATS, FEATURES, METADATA, "KHR_mesh_quantization"}
# Extensions of meshes beside the Gaussians.
_OF_SURFACES = ("KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_lights_")
# Bytes of Gaussians for a byte of the file, plain and as SPZ; beyond it primitives repeat accessors to no end.
_REPEATS, _REPEATS_PACKED = 32, 500
_EXPORT_PLAIN = "export it uncompressed (with KHR_gaussian_splatting alone), or as PLY"
# splat-transform does not read glTF.
_TURN = "export the splat as PLY, and apply the transform to the PLY with splat-transform"
_MERGE = "export each splat as PLY, and merge them with splat-transform"


def read_gltf(path: str | Path) -> Gaussians:
    """Read the Gaussians of a .glb or .gltf file, which one node of its scene contains.

    The world's axes (left, up, forward) are turned to those of 3DGS by signs (``axes``).

    Buffers may be inside, or in files beside or below it. Values are kept bit by bit, but for positions that nodes
    translate. Nodes that rotate or scale them become the frame of the world: its up, and the metres of its unit.
    """
    document = read_document(path)
    for name in _names(document.root, "extensionsRequired"):
        if name not in _UNDERSTOOD and not name.startswith((_SPZ, *_OF_SURFACES)):
            raise document.error(f"needs the extension {name[:60]!a}, which is not read", _EXPORT_PLAIN)
    packed = any(name.startswith(_SPZ) for name in _names(document.root, "extensionsUsed"))
    most = _REPEATS_PACKED if packed else _REPEATS
    primitives, world, translation = _placed_splats(document)
    parts: list[Columns] = []
    total = 0
    for primitive in primitives:
        parts.append(_read_primitive(document, primitive))
        total += sum(column.nbytes for column in parts[-1].values())
        if total > most * document.data_bytes:
            raise document.error("repeats its Gaussians far too often", "remove the copies")
    bases = max(columns["sh"].shape[1] for columns in parts)  # primitives may have different degrees
    for columns in parts:
        columns["sh"] = np.pad(columns["sh"], ((0, 0), (0, bases - columns["sh"].shape[1]), (0, 0)))
    joined = {name: np.concatenate([columns[name] for columns in parts]) for name in parts[0]}
    if translation.any():
        with np.errstate(all="ignore"):
            joined["means"] = (joined["means"].astype(np.float64) + translation).astype(np.float32)
    gaussians, _ = keep_finite(**half_turn(joined, AXIS), source=str(document.path))
    return replace(gaussians, world=world)


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


# ---- nodes: the one with Gaussians


@np.errstate(all="ignore")  # translations beyond all numbers: rows that are not finite are dropped
def _placed_splats(document: GltfDocument) -> tuple[list[JsonNode], WorldFrame, np.ndarray]:
    """Return the primitives with Gaussians of the scene, and the frame and translation [3] float64 of their node."""
    waiting = [(index, np.eye(4)) for index in reversed(_roots(document))]
    seen: set[str] = set()
    placed: tuple[list[JsonNode], np.ndarray, float, str] | None = None
    while waiting:
        index, above = waiting.pop()
        node = document.entry("nodes", index)
        if node.place in seen:
            raise document.error(f"{node.place} has several parents, or is below itself")
        seen.add(node.place)
        matrix = above @ _own_matrix(node)
        mesh = node.get("mesh")
        if mesh.value is not None and (splats := _splat_primitives(document.entry("meshes", mesh))):
            if (scale := similarity_scale(matrix)) is None:
                raise document.error(f"{node.place} is mirrored or stretched", _TURN)
            if placed is not None:
                raise document.error(f"{placed[3]} and {node.place} both contain Gaussians", _MERGE)
            placed = splats, matrix, scale, node.place
        waiting += [(child, matrix) for child in reversed(_nodes(node, "children"))]
    if placed is None:
        raise _no_gaussians(document)
    primitives, matrix, scale, _ = placed
    return primitives, *_frame_of(matrix, scale)


def _splat_primitives(mesh: JsonNode) -> list[JsonNode]:
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


def _own_matrix(node: JsonNode) -> np.ndarray:
    """Return the transform [4, 4] float64 of a node."""

    def numbers(name: str, *default: float) -> np.ndarray:
        given = node.get(name)
        return np.array(default) if given.value is None else given.numbers(len(default))

    matrix = numbers("matrix", *np.eye(4).ravel()).reshape(4, 4).T
    own = np.eye(4)
    w_last = numbers("rotation", 0.0, 0.0, 0.0, 1.0)
    rotation = rotation_matrices(torch.from_numpy(np.roll(w_last, 1))[None])[0].numpy()
    own[:3, :3] = rotation * numbers("scale", 1.0, 1.0, 1.0)
    own[:3, 3] = numbers("translation", 0.0, 0.0, 0.0)
    return matrix @ own


def _frame_of(matrix: np.ndarray, scale: float) -> tuple[WorldFrame, np.ndarray]:
    """Return the frame of a node's similarity [4, 4], and the translation [3] in the axes of its Gaussians."""
    inner = matrix[:3, :3]
    if (inner == np.eye(3)).all():
        return WorldFrame(), matrix[:3, 3]
    # The row: y of the world in the axes of the Gaussians.
    up = turned_direction((inner[1] / scale).tolist(), AXIS)
    unit = None if abs(scale - 1) < 1e-6 else scale
    return WorldFrame(unit, (up[0], up[1], up[2])), np.linalg.solve(inner, matrix[:3, 3])


# ---- the Gaussians of one primitive, in its own frame


def _read_primitive(document: GltfDocument, primitive: JsonNode) -> Columns:
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
    if len({len(values) for values in (*columns.values(), *coefficients)}) > 1:
        raise document.error("the attributes of its Gaussians have different counts")
    return {**columns, "sh": np.stack(coefficients, axis=1)}


def _packed_columns(document: GltfDocument, content: bytes) -> Columns:
    _, columns = spz_columns(document.path, content)
    if columns["sh"].shape[1] > (SH_DEGREE + 1) ** 2:
        problem = f"has SH of a degree above {SH_DEGREE}, which glTF does not know"
        raise document.error(problem, _EXPORT_PLAIN)
    return half_turn(columns, AXIS)  # to left, up, forward


FORMAT = SplatFormat("glTF", (".glb", ".gltf"), read_gltf, write_gltf, axis=AXIS, in_scenes=False)
