"""Up of a splat without cameras."""

from __future__ import annotations

import math
import warnings

import torch
from torch import Tensor

from scoup.base import ScoupWarning
from scoup.scene import Gaussians, rotation_matrices

FLAT = 0.3  # shortest by middle standard deviation, below which a Gaussian lies in a surface
CONE = math.cos(math.radians(12))  # normals within it face the same way
REACH = math.cos(math.radians(26))  # how far from an axis of the file its surfaces may be tilted
LEVELLED = 0.7  # of the normals that face a tilted direction: an axis of the file that has as many is kept
LEVEL = 2.5  # times chance: normals in a cone that mark the floors of a scene
PLAIN = 8.0  # times chance: normals along z that overrule the usual frame, where they are
AHEAD = 1.2  # times those along y, and more in the lowest quarter of the scene than in the highest


def estimate_up_of_splat(gaussians: Gaussians, rows: Tensor) -> Tensor:
    """Return [3] float64, the direction along which floors, tables and shelves face.

    Trainers leave -y up (axes right, down, forward), or +z. Surfaces decide between them, and how far up is tilted:
    flat Gaussians have their shortest axis across the surface. A floor lies at the bottom of a scene; a wall that
    faces the cameras, which also lies across z, at its far end. The Gaussians ``rows`` [M] count.

    Warns:
        ScoupWarning: there are no such surfaces, so that -y is a guess.
    """
    normals, weights = _normals(gaussians, rows)
    down, high = (torch.tensor(axis, dtype=torch.float64) for axis in ((0, -1, 0), (0, 0, 1)))
    (along_y, y), (along_z, z) = (_facing(normals, weights, axis) for axis in (down, high))
    if z > PLAIN and z > AHEAD * y and _is_floor(gaussians.means[rows].double(), normals, weights, along_z):
        return along_z
    if y > LEVEL:
        return along_y
    warnings.warn(
        "the splat shows neither floors nor tables, so that up is a guess: -y. If its views are upside down, make them "
        "with scoup views and `up` (such as 0 1 0), or `keep_axes` for an .spz or glTF with the axes of a PLY",
        ScoupWarning,
        stacklevel=3,
    )
    return down


def _facing(normals: Tensor, weights: Tensor, axis: Tensor) -> tuple[Tensor, float]:
    """Return the direction near an axis that most surfaces face, and how many times more than by chance."""
    if not float(weights.sum()) > 0:
        return axis, 0.0
    direction = axis
    for cone in (REACH, CONE, CONE, CONE):
        near = (normals @ direction).abs() > cone
        spread = (normals[near] * weights[near, None]).T @ normals[near]
        direction = torch.linalg.eigh(spread).eigenvectors[:, 2]
        direction = direction if float(direction @ axis) > 0 else -direction
    if float(direction @ axis) < REACH:
        return axis, 0.0
    tilted, level = (
        float(weights[(normals @ candidate).abs() > CONE].sum() / weights.sum()) / (1 - CONE)
        for candidate in (direction, axis)
    )
    return (axis, level) if level >= LEVELLED * tilted else (direction, tilted)


def _is_floor(means: Tensor, normals: Tensor, weights: Tensor, axis: Tensor) -> bool:
    """Return whether more of the surfaces that face an axis are in the lowest quarter along it than in the highest."""
    heights = means @ axis
    low, high = heights[:: max(1, len(heights) // 100_000)].quantile(heights.new_tensor([0.03, 0.97]))
    facing = weights * ((normals @ axis).abs() > CONE)
    relative = (heights - low) / (high - low)
    return float(facing[relative < 0.25].sum()) > float(facing[relative > 0.75].sum())


def _normals(gaussians: Gaussians, rows: Tensor) -> tuple[Tensor, Tensor]:
    """Return the shortest axes [M, 3] of Gaussians, and the area of the flat ones, 0 for others, [M] float64."""
    scales, turned = gaussians.scales[rows].double(), rotation_matrices(gaussians.quats[rows].double())
    shortest = scales.argmin(1)[:, None, None].expand(-1, 3, 1)
    sizes = scales.sort(1).values
    area = sizes[:, 1] * sizes[:, 2] * (sizes[:, 0] < FLAT * sizes[:, 1])
    most = area[:: max(1, len(area) // 100_000)].quantile(0.95)
    return turned.gather(2, shortest)[:, :, 0], area.clamp(max=float(most))
