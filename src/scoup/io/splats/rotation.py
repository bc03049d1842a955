"""Rotations of Gaussians and of the spherical harmonics of their colours."""

from __future__ import annotations

import numpy as np
import torch

from scoup.scene import quats_of_rotations, sh_basis


def rotated_quats(quats: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Return quaternions [N, 4] (w, x, y, z) turned by a rotation [3, 3]: float32."""
    a, b, c, d = quats_of_rotations(torch.from_numpy(rotation)[None])[0].tolist()
    left = np.array([[a, -b, -c, -d], [b, a, -d, c], [c, d, a, -b], [d, -c, b, a]])
    with np.errstate(all="ignore"):
        return (quats.astype(np.float64) @ left.T).astype(np.float32)


def without_largest(quats: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the index [N] of the largest component by size of unit quaternions [N, 4], and the others [N, 3] in order,
    with the sign that makes the largest positive."""
    which = np.abs(quats).argmax(1)
    is_largest = np.arange(4) == which[:, None]
    positive = quats * np.where(quats[is_largest] < 0, -1.0, 1.0)[:, None]
    return which, positive[~is_largest].reshape(-1, 3)


def with_largest(which: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return the quaternions [N, 4] float64 of ``without_largest``."""
    is_largest = np.arange(4) == which[:, None]
    quats = np.empty((len(which), 4))
    quats[~is_largest] = others.ravel()
    quats[is_largest] = np.sqrt(np.clip(1.0 - (others**2).sum(1), 0.0, None))
    return quats


def rotated_sh(sh: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Return coefficients [N, B, 3] of colours that are turned with the Gaussians: float32.

    The colour seen along a direction d becomes the one that was seen along the direction that turns to d. Within a
    degree this is a linear map; it follows from the basis at directions before and after turning.
    """
    if sh.shape[1] == 1:
        return sh
    directions, most = spread_directions(64), round(sh.shape[1] ** 0.5) - 1
    before, after = (
        sh_basis(torch.from_numpy(vectors), most).numpy() for vectors in (directions @ rotation, directions)
    )
    turned = [sh[:, :1].astype(np.float32)]
    for degree in range(1, most + 1):
        columns = slice(degree * degree - 1, (degree + 1) ** 2 - 1)  # without the constant one
        matrix = np.linalg.lstsq(after[:, columns], before[:, columns], rcond=None)[0]
        coefficients = sh[:, degree * degree : (degree + 1) ** 2].astype(np.float64)
        with np.errstate(all="ignore"):
            turned.append(np.einsum("ij,njc->nic", matrix, coefficients).astype(np.float32))
    return np.concatenate(turned, axis=1)


def spread_directions(count: int) -> np.ndarray:
    """Return [count, 3] unit vectors, spread evenly in a spiral."""
    steps = np.arange(count) + 0.5
    height, angle = 1 - 2 * steps / count, steps * np.pi * (1 + 5**0.5)
    width = np.sqrt(1 - height**2)
    return np.stack([width * np.cos(angle), width * np.sin(angle), height], axis=1)
