"""Rotations as matrices and as quaternions (w, x, y, z)."""

from __future__ import annotations

import torch
from torch import Tensor


def rotation_matrices(quats: Tensor) -> Tensor:
    """Return [M, 3, 3] rotation matrices of quaternions [M, 4], normalised first."""
    w, x, y, z = (quats / torch.linalg.vector_norm(quats, dim=1, keepdim=True)).unbind(1)
    return torch.stack(
        [
            torch.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], 1),
            torch.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], 1),
            torch.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], 1),
        ],
        1,
    )


def quats_of_rotations(rotations: Tensor) -> Tensor:
    """Return [M, 4] unit quaternions of rotation matrices [M, 3, 3]."""
    (a, b, c), (d, e, f), (g, h, i) = (row.unbind(1) for row in rotations.unbind(1))
    # Of the outer product of the quaternion with itself, the column with the largest diagonal is the most exact.
    outer = torch.stack(
        [
            torch.stack([1 + a + e + i, h - f, c - g, d - b], 1),
            torch.stack([h - f, 1 + a - e - i, b + d, c + g], 1),
            torch.stack([c - g, b + d, 1 - a + e - i, f + h], 1),
            torch.stack([d - b, c + g, f + h, 1 - a - e + i], 1),
        ],
        1,
    )
    largest = outer.diagonal(dim1=1, dim2=2).argmax(1)
    return torch.nn.functional.normalize(outer[torch.arange(len(outer)), largest], dim=1)
