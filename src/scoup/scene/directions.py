"""Directions: unit embeddings of regions and texts, rotations, and the direction that is up."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import torch
from numpy.typing import ArrayLike
from torch import Tensor

from scoup.base import InputError
from scoup.scene.cameras import Camera

UPRIGHT = 0.01  # how much the cameras' own up counts beside their right sides being level

NEARLY_UNIT = 1e-5
"""Rows whose norm is this near to 1 are left as they are, to the last bit."""


def float_rows(vectors: Tensor | ArrayLike, what: str) -> Tensor:
    """Return [R, D] float32 of a floating-point tensor or array, checked; ``what`` is its name in messages."""
    rows = torch.as_tensor(vectors).detach()
    if rows.dim() != 2 or rows.shape[1] == 0:
        raise InputError(f"{what} must be [R, D], got {list(rows.shape)}")
    if not rows.is_floating_point():
        raise InputError(f"{what} must be floating-point numbers, got {rows.dtype}")
    rows = rows.float()
    # A value that is not finite makes the sum not finite: check single values only then.
    if not torch.isfinite(rows.sum()):
        bad = ~torch.isfinite(rows).all(1)
        if bad.any():
            raise InputError(
                f"{int(bad.sum())} of {len(rows)} {what} have values that are not finite, "
                f"the first is row {int(bad.nonzero()[0])}; drop or replace them"
            )
    return rows


def normalise_embeddings(embeddings: Tensor | ArrayLike) -> Tensor:
    """Return ``float_rows`` scaled to unit norm, [R, D] float32; rows of norm zero stay zero."""
    rows = float_rows(embeddings, "embeddings")
    # Twice: the square of a very small or large number may leave the range of float32.
    rows = rows / torch.clamp(rows.abs().amax(1, keepdim=True), min=torch.finfo(torch.float32).tiny)
    return torch.nn.functional.normalize(rows, dim=1)


def unit_rows(vectors: Tensor | ArrayLike, what: str = "embeddings", lengthen: bool = True) -> Tensor:
    """Return [R, D] float32 rows of unit norm; rows of norm zero stay zero, those of nearly unit norm as they are and,
    without ``lengthen``, those of a norm below 1, too."""
    rows = float_rows(vectors, what)
    excess = torch.linalg.vector_norm(rows, dim=1) - 1
    off = ~((excess.abs() if lengthen else excess) <= NEARLY_UNIT)
    if not off.any():
        return rows
    off &= (rows != 0).any(1)
    return torch.where(off[:, None], normalise_embeddings(rows), rows)


def query_vectors(
    vectors: Tensor | ArrayLike, dim: int, what: str = "queries", lengthen: bool = True
) -> Tensor:
    """Return one direction [D] or several [Q, D], of any norm but zero, as [Q, D] float32 of unit norm
    (``unit_rows``)."""
    try:
        given = torch.as_tensor(vectors)
    except (TypeError, ValueError, RuntimeError):
        raise InputError(
            f"{what} must be vectors [{dim}] or [count, {dim}], got {str(vectors)[:60]}"
        ) from None
    rows = given[None] if given.dim() == 1 else given
    if rows.dim() != 2 or rows.shape[1] != dim or not len(rows):
        raise InputError(f"{what} {list(given.shape)} must be [{dim}] or [count, {dim}]")
    directions = unit_rows(rows, what, lengthen)
    zero = ~directions.any(1)
    if zero.any():
        raise InputError(f"{what}: row {int(zero.nonzero()[0])} is zero, which has no direction")
    return directions


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


def checked_direction(up: Sequence[float]) -> Tensor:
    """Return [3] float64, the unit vector of a direction; an InputError if it is none."""
    direction = torch.as_tensor(tuple(up), dtype=torch.float64).flatten()
    if direction.shape != (3,) or not bool(direction.isfinite().all()) or not bool(direction.any()):
        raise InputError(f"up: expected three numbers that are not all 0, got {list(up)}")
    direction = direction / direction.abs().max()  # whose squares are in range
    return direction / direction.norm()


def estimate_up(cameras: Iterable[Camera]) -> Tensor:
    """Return the up direction [3] float64 for which the cameras are level: people hold them so. Without cameras, +z.

    It is orthogonal to the right sides of all images as far as possible; where they all point the same way, the
    images' own up decides.
    """
    poses = [torch.as_tensor(camera.viewmat)[:3, :3].double().cpu() for camera in cameras]
    if not poses:
        return torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    rotations = torch.stack(poses)
    right, own_up = rotations[:, 0], -rotations[:, 1].mean(0)
    image_up = own_up / own_up.norm().clamp(min=1e-9)
    tilt = right.T @ right / len(right) - UPRIGHT * image_up[:, None] * image_up
    up = torch.linalg.eigh(tilt).eigenvectors[:, 0]
    # Cameras that look straight down have no up of their own in the scene, but look down.
    upright = own_up - UPRIGHT * rotations[:, 2].mean(0)
    return up if float(up @ upright) >= 0 else -up
