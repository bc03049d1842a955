"""The direction that is up in a splat without cameras."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from scoup.base.errors import InputError
from scoup.scene.gaussians import Gaussians

FLAT = 0.3  # shortest by middle standard deviation, below which a Gaussian lies in a surface
CONE = math.cos(math.radians(12))  # normals within it face the same way
REACH = math.cos(math.radians(26))  # how far from an axis of the file its surfaces may be tilted
LEVELLED = 0.7  # of the normals that face a tilted direction: an axis of the file that has as many is kept
LEVEL = 2.5  # times chance: normals in a cone that mark the floors of a scene
PLAIN = 8.0  # times chance, and twice those along y: normals along z that overrule the usual frame


def checked_direction(up: Sequence[float]) -> Tensor:
    """Return [3] float64, the unit vector of a direction.

    Raises:
        InputError: it is none.
    """
    direction = torch.as_tensor(tuple(up), dtype=torch.float64).flatten()
    if direction.shape != (3,) or not bool(direction.isfinite().all()) or not float(direction.norm()) > 0:
        raise InputError(f"up: expected three numbers that are not all 0, got {list(up)}")
    return direction / direction.norm()


def estimate_up_of_splat(gaussians: Gaussians, rows: Tensor) -> Tensor:
    """Return [3] float64, the direction along which floors, tables and shelves face.

    Trainers leave -y up (axes right, down, forward), or +z. Surfaces decide between them, and how far up is tilted:
    flat Gaussians have their shortest axis across the surface.

    Args:
        rows: [M] int64, the Gaussians that count.
    """
    normals, weights = _normals(gaussians, rows)
    down, high = (torch.tensor(axis, dtype=torch.float64) for axis in ((0, -1, 0), (0, 0, 1)))
    (along_y, y), (along_z, z) = (_facing(normals, weights, axis) for axis in (down, high))
    if z > PLAIN and z > 2 * y:
        return along_z
    return along_y if y > LEVEL else down


def _facing(normals: Tensor, weights: Tensor, axis: Tensor) -> tuple[Tensor, float]:
    """Return the direction near an axis that most surfaces face, and how many times more than by chance."""
    if not float(weights.sum()) > 0:
        return axis, 0.0
    found = axis
    for cone in (REACH, CONE, CONE, CONE):
        near = (normals @ found).abs() > cone
        spread = (normals[near] * weights[near, None]).T @ normals[near]
        found = torch.linalg.eigh(spread).eigenvectors[:, 2]
        found = found if float(found @ axis) > 0 else -found
    if float(found @ axis) < REACH:
        return axis, 0.0
    tilted, level = (
        float(weights[(normals @ each).abs() > CONE].sum() / weights.sum()) / (1 - CONE)
        for each in (found, axis)
    )
    return (axis, level) if level >= LEVELLED * tilted else (found, tilted)


def _normals(gaussians: Gaussians, rows: Tensor) -> tuple[Tensor, Tensor]:
    """Return the shortest axes [M, 3] of Gaussians, and the area of the flat ones, 0 for others, [M] float64."""
    from scipy.spatial.transform import Rotation

    scales, quats = gaussians.scales[rows].double(), gaussians.quats[rows].double()
    turned = torch.from_numpy(Rotation.from_quat(quats[:, [1, 2, 3, 0]].numpy()).as_matrix())
    shortest = scales.argmin(1)[:, None, None].expand(-1, 3, 1)
    sizes = scales.sort(1).values
    area = sizes[:, 1] * sizes[:, 2] * (sizes[:, 0] < FLAT * sizes[:, 1])
    most = area[:: max(1, len(area) // 100_000)].quantile(0.95)
    return turned.gather(2, shortest)[:, :, 0], area.clamp(max=float(most))
