"""Meshes whose areas and silhouettes are known."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from scoup_lab.synthetic.art.meshes import Floats, Mesh


def sphere(radius: float, centre: ArrayLike = (0, 0, 0), segments: int = 24) -> Mesh:
    """A ball of rings and meridians."""
    tilt = np.linspace(-np.pi / 2, np.pi / 2, segments // 2 + 1)[1:-1]
    turn = np.arange(segments) * (2 * np.pi / segments)
    level = np.cos(tilt)[:, None]
    rings = np.stack(
        np.broadcast_arrays(level * np.cos(turn), level * np.sin(turn), np.sin(tilt)[:, None]), -1
    )
    outwards = np.concatenate([rings.reshape(-1, 3), [[0, 0, -1], [0, 0, 1]]])
    low, high = len(outwards) - 2, len(outwards) - 1
    numbers = np.arange(low).reshape(len(tilt), segments)
    following = np.roll(numbers, -1, axis=1)
    a, b, c, d = numbers[:-1], following[:-1], following[1:], numbers[1:]
    faces = [(a, b, c), (a, c, d), (low, following[0], numbers[0]), (high, numbers[-1], following[-1])]
    corners = [np.stack(np.broadcast_arrays(*face), -1).reshape(-1, 3) for face in faces]
    return Mesh(outwards * radius, outwards, np.concatenate(corners)).moved(centre)


def rectangle(corner: ArrayLike, first: ArrayLike, second: ArrayLike) -> Mesh:
    """From a corner along two edges [3], seen from where first x second points."""
    start, u, v = (np.asarray(vector, float) for vector in (corner, first, second))
    normal = np.cross(u, v)
    normals = np.tile(normal / np.linalg.norm(normal), (4, 1))
    return Mesh(
        np.stack([start, start + u, start + u + v, start + v]), normals, np.array([[0, 1, 2], [0, 2, 3]])
    )


def half_turn() -> Floats:
    """[3, 3] rotation by 180 degrees about y."""
    return np.diag([-1.0, 1.0, -1.0])
