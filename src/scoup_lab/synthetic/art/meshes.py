"""Triangle meshes of simple shapes, from which all things are built."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

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

    def flipped(self) -> Mesh:
        """Return the mesh inside out."""
        return replace(self, normals=-self.normals, faces=self.faces[:, ::-1].copy())


def merged(meshes: Sequence[Mesh]) -> Mesh:
    """Return all meshes as one."""
    starts = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes[:-1]])
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.normals for mesh in meshes]),
        np.concatenate([mesh.faces + start for mesh, start in zip(meshes, starts, strict=True)]),
    )


def rotation(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Floats:
    """Return [3, 3] rotation by degrees about x, then y, then z."""
    turn = np.eye(3)
    for axis, degrees in ((0, x), (1, y), (2, z)):
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        step = np.eye(3)
        i, j = [(1, 2), (2, 0), (0, 1)][axis]
        step[i, i], step[i, j], step[j, i], step[j, j] = c, -s, s, c
        turn = step @ turn
    return turn


def smooth_curve(points: ArrayLike, samples: int = 24) -> Floats:
    """Return [samples, d] points on a Catmull-Rom spline through ``points`` [P, d], both ends included."""
    knots = np.asarray(points, float)
    padded = np.concatenate([2 * knots[:1] - knots[1:2], knots, 2 * knots[-1:] - knots[-2:-1]])
    position = np.linspace(0, len(knots) - 1, samples)
    start = np.minimum(position.astype(int), len(knots) - 2)
    t = (position - start)[:, None]
    p0, p1, p2, p3 = (padded[start + step] for step in range(4))
    return 0.5 * (
        2 * p1 + (p2 - p0) * t + (2 * p0 - 5 * p1 + 4 * p2 - p3) * t**2 + (3 * (p1 - p2) + p3 - p0) * t**3
    )


def sheet(points: ArrayLike, closed_rows: bool = False, closed_columns: bool = False) -> Mesh:
    """Return a surface through a grid of points [A, B, 3]; ``closed_*`` joins the last row or column to the first.

    Normals follow rows x columns of the grid.
    """
    grid = np.asarray(points, float)
    rows, columns = grid.shape[:2]
    numbers = np.arange(rows * columns).reshape(rows, columns)
    if closed_rows:
        numbers = np.concatenate([numbers, numbers[:1]])
    if closed_columns:
        numbers = np.concatenate([numbers, numbers[:, :1]], axis=1)
    a, b = numbers[:-1, :-1].ravel(), numbers[1:, :-1].ravel()
    c, d = numbers[1:, 1:].ravel(), numbers[:-1, 1:].ravel()
    return with_normals(grid.reshape(-1, 3), np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]))


def with_normals(vertices: Floats, faces: Ints) -> Mesh:
    """Return a mesh whose vertex normals are the area-weighted means of the faces around; empty triangles
    are dropped."""
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    face_normals = np.cross(b - a, c - a)
    kept = np.linalg.norm(face_normals, axis=1) > 1e-12
    faces, face_normals = faces[kept], face_normals[kept]
    normals = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(normals, faces[:, corner], face_normals)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return Mesh(vertices, normals, faces)


def lathe(profile: ArrayLike, segments: int = 32) -> Mesh:
    """Return a surface of revolution about z.

    ``profile``: [P, 2] radius and height, in the order that keeps the solid on the left (bottom centre,
    outside upwards, top centre). A point given twice is a sharp edge.
    """
    points = np.asarray(profile, float)
    cuts = [0, *(1 + np.flatnonzero((points[1:] == points[:-1]).all(1))).tolist(), len(points)]
    angles = np.arange(segments) * (2 * np.pi / segments)
    circle = np.stack([np.cos(angles), np.sin(angles)], 1)
    bands = []
    for start, end in itertools.pairwise(cuts):
        radius, height = points[start:end, 0], points[start:end, 1]
        ring = np.empty((segments, end - start, 3))
        ring[..., :2] = circle[:, None] * radius[None, :, None]
        ring[..., 2] = height
        bands.append(sheet(ring, closed_rows=True))
    return merged(bands)


def cylinder(
    radius: float, height: float, bevel: float = 0.0, segments: int = 32, top: float | None = None
) -> Mesh:
    """Return a closed cylinder on z = 0, or a cone frustum where ``top`` gives another radius for its upper end."""
    upper = radius if top is None else top
    edge = min(bevel, height / 2, radius, upper if upper > 0 else bevel)
    arc = np.linspace(0, np.pi / 2, 5)
    low = np.stack([radius - edge + edge * np.sin(arc), edge - edge * np.cos(arc)], 1)
    high = np.stack([upper - edge + edge * np.cos(arc), height - edge + edge * np.sin(arc)], 1)
    ends = np.array([[0.0, 0.0]]), np.array([[0.0, height]])
    if edge == 0:
        low, high = low[[0, 0]], high[[0, 0]]
    return lathe(np.concatenate([ends[0], low, high, ends[1]]), segments)


def ellipsoid(
    radii: float | ArrayLike, centre: ArrayLike = (0, 0, 0), segments: int = 24, power: float = 1.0
) -> Mesh:
    """Return an ellipsoid with the given radii (one number or three); ``power`` below 1 squares it off like
    a cushion."""
    tilt = np.linspace(-np.pi / 2, np.pi / 2, segments // 2 + 1)[None, :]
    turn = (np.arange(segments) * (2 * np.pi / segments))[:, None]

    def bulged(values: Floats) -> Floats:
        return np.sign(values) * np.abs(values) ** power

    level = bulged(np.cos(tilt).clip(min=0))
    unit = np.stack(
        np.broadcast_arrays(level * bulged(np.cos(turn)), level * bulged(np.sin(turn)), np.sin(tilt)), -1
    )
    ball = sheet(unit * np.broadcast_to(np.asarray(radii, float), 3), closed_rows=True)
    if power == 1.0:
        outwards = ball.vertices / np.broadcast_to(np.asarray(radii, float), 3) ** 2
        ball = replace(ball, normals=outwards / np.linalg.norm(outwards, axis=1, keepdims=True))
    return ball.moved(centre)


def tube(path: ArrayLike, radius: float | ArrayLike, segments: int = 12, squash: float = 1.0) -> Mesh:
    """Return a round bar along ``path`` [P, 3] with rounded-off flat ends.

    ``path``: [P, 3] centre line; ``radius``: one number, or [P].
    """
    line = np.asarray(path, float)
    radii = np.broadcast_to(np.asarray(radius, float), len(line))
    along = np.gradient(line, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    side = np.cross(along[0], np.eye(3)[np.abs(along[0]).argmin()])
    angles = np.arange(segments) * (2 * np.pi / segments)
    rings = []
    for centre, direction, size in zip(line, along, radii, strict=True):
        side = side - direction * (side @ direction)  # carried along, so that the tube does not twist
        side /= np.linalg.norm(side)
        other = np.cross(direction, side)
        rings.append(
            centre + size * (np.cos(angles)[:, None] * side + squash * np.sin(angles)[:, None] * other)
        )
    ends = [np.repeat(line[:1], segments, 0), *rings, np.repeat(line[-1:], segments, 0)]
    return sheet(np.stack(ends, 1), closed_rows=True)


def torus(ring: float, radius: float, segments: int = 32, squash: float = 1.0) -> Mesh:
    """Return a torus about z, centred on the origin; ``squash`` scales its height."""
    turn = (np.arange(segments) * (2 * np.pi / segments))[:, None]
    tilt = (np.arange(segments // 2) * (4 * np.pi / segments))[None, :]
    level = ring + radius * np.cos(tilt)
    height = radius * squash * np.sin(tilt)
    points = np.stack(np.broadcast_arrays(level * np.cos(turn), level * np.sin(turn), height), -1)
    return sheet(points, closed_rows=True, closed_columns=True)


def box(size: ArrayLike, bevel: float = 0.3, centre: ArrayLike = (0, 0, 0)) -> Mesh:
    """Return a box with rounded edges and corners, [3] side lengths, centred on ``centre``."""
    half = np.asarray(size, float) / 2
    edge = min(bevel, float(half.min()))
    inner = half - edge
    sides = []
    for axis in range(3):
        others = [(axis + 1) % 3, (axis + 2) % 3]
        for sign in (-1.0, 1.0):
            u, v = np.meshgrid(*(_beveled_steps(half[other], edge) for other in others), indexing="ij")
            points = np.empty((*u.shape, 3))
            points[..., axis] = sign * half[axis]
            points[..., others[0]], points[..., others[1]] = u, v
            core = np.clip(points, -inner, inner)
            outwards = points - core
            outwards /= np.maximum(np.linalg.norm(outwards, axis=-1, keepdims=True), 1e-12)
            side = sheet(core + outwards * edge)
            if sign < 0:
                side = side.flipped()
            sides.append(replace(side, normals=outwards.reshape(-1, 3)))
    return merged(sides).moved(centre)


def _beveled_steps(half: float, edge: float) -> Floats:
    rounded = half - edge * np.array([0.0, 0.3, 0.65, 1.0])
    return np.unique(np.concatenate([-rounded, rounded]))


def plane(origin: ArrayLike, across: ArrayLike, up: ArrayLike, step: float) -> Mesh:
    """Return a rectangle from ``origin`` along two edge vectors [3], cut into cells of about ``step``.

    The normal is across x up. Fine cells keep a wall that runs past the camera drawable: only the triangles
    behind it are dropped.
    """
    start, first, second = (np.asarray(vector, float) for vector in (origin, across, up))
    counts = [max(2, 1 + round(float(np.linalg.norm(edge)) / step)) for edge in (first, second)]
    u, v = (np.linspace(0, 1, count) for count in counts)
    return sheet(start + u[:, None, None] * first + v[None, :, None] * second)
