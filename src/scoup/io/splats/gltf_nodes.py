"""Where the primitives of a glTF scene stand: the way from their own frames to the world's."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from scoup.base.json_node import JsonNode
from scoup.io.splats.gltf_document import GltfDocument, extension
from scoup.scene.rotations import rotation_matrices

SPLATS = "KHR_gaussian_splatting"

UNIFORM_TOLERANCE = (
    1e-4  # of the ratio of two scales: what float32 matrices stay within after several products
)
_APPLY = "apply the transform of the node in the program that made the file, and export it again"


@dataclass(frozen=True)
class Similarity:
    """x -> scale * rotation @ x + translation; all float64."""

    scale: float
    rotation: np.ndarray  # [3, 3]
    translation: np.ndarray  # [3]


def placed_splats(document: GltfDocument) -> Iterator[tuple[dict[str, Any], Similarity | None]]:
    """Yield the primitives with Gaussians of the scene, each with its way to the world (None where it is there
    already).

    A mesh that several nodes use comes once for each of them.
    """
    of_meshes: dict[int, list[dict[str, Any]]] = {}
    waiting = [(root, np.eye(4)) for root in reversed(_roots(document))]
    seen: set[int] = set()
    while waiting:
        index, above = waiting.pop()
        node = document.entry("nodes", index, "a node of the scene")
        key = int(index)
        if key in seen:
            raise document.error(f"nodes[{key}] has several parents, or is below itself")
        seen.add(key)
        matrix = _combined(document, above, node, key)
        if node.get("mesh") is not None:
            mesh = document.whole(node["mesh"], f"the mesh of nodes[{key}]")
            if mesh not in of_meshes:
                of_meshes[mesh] = splat_primitives(document, mesh)
            if of_meshes[mesh]:
                similarity = _similarity(document, matrix, key)
                yield from ((primitive, similarity) for primitive in of_meshes[mesh])
        waiting += [(child, matrix) for child in reversed(_children(document, node, f"nodes[{key}]"))]


def splat_primitives(document: GltfDocument, mesh: int) -> list[dict[str, Any]]:
    """Return the primitives of a mesh that hold Gaussians."""
    primitives = document.entry("meshes", mesh, "a mesh").get("primitives")
    if not isinstance(primitives, list):
        raise document.error(f"meshes[{mesh}] has no primitives")
    return [item for item in primitives if isinstance(item, dict) and extension(item, SPLATS) is not None]


def _roots(document: GltfDocument) -> list[int]:
    """Return the top nodes of the scene that is shown; without scenes, the nodes that have no parent."""
    if document.entries("scenes"):
        scene = document.entry("scenes", document.root.get("scene", 0), "the scene")
        return _children(document, scene, "the scene", "nodes")
    nodes = [item for item in document.entries("nodes") if isinstance(item, dict)]
    below = {child for node in nodes for child in _children(document, node, "a node")}
    return [index for index in range(len(document.entries("nodes"))) if index not in below]


def _children(document: GltfDocument, item: dict[str, Any], what: str, name: str = "children") -> list[int]:
    value = item.get(name, [])
    if not isinstance(value, list):
        raise document.error(f"the {name} of {what} are not a list")
    return [document.whole(child, f"an index in the {name} of {what}") for child in value]


def _combined(document: GltfDocument, above: np.ndarray, node: dict[str, Any], index: int) -> np.ndarray:
    with np.errstate(all="ignore"):
        matrix = above @ _own_matrix(document, node, index)
    if not np.isfinite(matrix).all():
        raise document.error(f"the transform of nodes[{index}] is not finite")
    return matrix


def _own_matrix(document: GltfDocument, node: dict[str, Any], index: int) -> np.ndarray:
    """Return [4, 4] float64 of a node's matrix, or of its translation, rotation and scale."""

    def numbers(name: str, default: list[float]) -> np.ndarray:
        place = f"nodes[{index}].{name}"
        return JsonNode(document.path, node.get(name, default), place=place).numbers(len(default))

    if "matrix" in node:
        matrix = numbers("matrix", [0.0] * 16).reshape(4, 4).T
        if matrix[3].tolist() != [0, 0, 0, 1]:
            raise document.error(f"the matrix of nodes[{index}] does not end with 0, 0, 0, 1")
        return matrix
    matrix = np.eye(4)
    quat = np.roll(numbers("rotation", [0.0, 0.0, 0.0, 1.0]), 1)
    with np.errstate(all="ignore"):
        if not 0 < np.linalg.norm(quat) < np.inf:
            raise document.error(f"the rotation of nodes[{index}] is not a quaternion")
        rotation = rotation_matrices(torch.from_numpy(quat)[None])[0].numpy()
        matrix[:3, :3] = rotation * numbers("scale", [1.0, 1.0, 1.0])
    matrix[:3, 3] = numbers("translation", [0.0, 0.0, 0.0])
    return matrix


def _similarity(document: GltfDocument, matrix: np.ndarray, index: int) -> Similarity | None:
    if (matrix == np.eye(4)).all():
        return None  # values are kept, bit by bit
    largest = float(np.abs(matrix[:3, :3]).max())
    left, sizes, right = np.linalg.svd(matrix[:3, :3] / (largest or 1.0))
    if sizes[0] >= sizes[2] * (1 + UNIFORM_TOLERANCE):  # so are all zeros
        raise document.error(f"nodes[{index}] stretches, shears or flattens its Gaussians", _APPLY)
    rotation = left @ right
    if np.linalg.det(rotation) < 0:
        raise document.error(f"nodes[{index}] mirrors its Gaussians", _APPLY)
    return Similarity(float(sizes.mean()) * largest, rotation, matrix[:3, 3])
