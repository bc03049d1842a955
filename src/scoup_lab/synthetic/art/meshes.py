"""Triangle meshes, the material of all things."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh."""

    vertices: Floats  # [V, 3] float64
    normals: Floats  # [V, 3] float64, unit norm, pointing outwards
    faces: Ints  # [F, 3] int64, rows of ``vertices``

    def face_areas(self) -> Floats:
        """Return [F] areas in squared units of the vertices."""
        a, b, c = (self.vertices[self.faces[:, corner]] for corner in range(3))
        return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)

    def moved(
        self, offset: ArrayLike = (0, 0, 0), rotation: Floats | None = None, scale: float = 1.0
    ) -> Mesh:
        """Return the mesh scaled, then rotated by a [3, 3] matrix, then shifted."""
        turn = np.eye(3) if rotation is None else rotation
        return Mesh(
            self.vertices * scale @ turn.T + np.asarray(offset, float), self.normals @ turn.T, self.faces
        )


def merged(meshes: Sequence[Mesh]) -> Mesh:
    """Return all meshes as one."""
    starts = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes[:-1]])
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.normals for mesh in meshes]),
        np.concatenate([mesh.faces + start for mesh, start in zip(meshes, starts, strict=True)]),
    )
