"""Axes of splat formats, and half-turns between them.

Gaussians have the axes of 3D Gaussian Splatting: x right, y down, z forward. A format that names its axes is turned
when it is read and written; all others keep the numbers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
import torch

from scoup.base import WorldFrame
from scoup.scene import Gaussians

Axis = Literal["x", "y", "z"]
"""Of a half-turn: x from 3DGS to right, up, back; z to left, up, forward."""
Columns = dict[str, np.ndarray]
"""means, quats (w, x, y, z), scales, opacities, sh, as ``keep_finite`` takes them."""


def half_turn(columns: Mapping[str, np.ndarray], axis: Axis) -> Columns:
    """Return Gaussians in axes turned by 180 degrees: signs change, all other bits stay."""
    return flipped(columns, [1 if name == axis else -1 for name in "xyz"])


def flipped(columns: Mapping[str, np.ndarray], signs: Sequence[int]) -> Columns:
    """Return Gaussians with the axes of sign -1 reversed; all other bits stay."""
    x, y, z = signs
    sh = columns["sh"]
    with np.errstate(all="ignore"):  # rows that are not finite are dropped later
        return {
            **columns,
            "means": columns["means"] * np.array(signs, np.float32),
            "quats": columns["quats"] * np.array([1, y * z, x * z, x * y], np.float32),
            "sh": sh * _sh_signs(sh.shape[1], x, y, z)[:, None],
        }


def turned(gaussians: Gaussians, axis: Axis) -> Gaussians:
    """Return ``half_turn`` of Gaussians, on the CPU."""
    columns = {name: tensor.detach().cpu().numpy() for name, tensor in gaussians.tensors().items()}
    turned_columns = half_turn(columns, axis)
    tensors = {name: torch.from_numpy(column) for name, column in turned_columns.items()}
    return replace(gaussians, **tensors, world=turned_world(gaussians.world, axis))


def turned_world(world: WorldFrame, axis: Axis) -> WorldFrame:
    return replace(world, **{
        name: turned_direction(direction, axis)
        for name in ("up", "north") if (direction := getattr(world, name)) is not None
    })  # fmt: skip


def upright(world: WorldFrame, axis: Axis) -> np.ndarray:
    """Return the rotation [3, 3] that makes up of a frame y, in the axes of a format whose y is up."""
    if world.up is None:
        return np.eye(3)
    from scipy.spatial.transform import Rotation

    return Rotation.align_vectors([[0.0, 1.0, 0.0]], [turned_direction(world.up, axis)])[0].as_matrix()


def turned_direction(direction: Sequence[float], axis: Axis) -> tuple[float, ...]:
    return tuple(value if name == axis else -value for name, value in zip("xyz", direction, strict=True))


def _sh_signs(count: int, x: int, y: int, z: int) -> np.ndarray:
    """Return the signs [count] of real spherical harmonics: products of the axes that each is odd in."""
    signs = []
    for degree in range(round(count**0.5)):
        for order in range(-degree, degree + 1):
            signs.append(x ** abs(order + (order < 0)) * y ** (order < 0) * z ** abs(degree + order))
    return np.array(signs, np.float32)
