"""Rotations of Gaussians and of the spherical harmonics of their colours (degree 3 at most)."""

from __future__ import annotations

import numpy as np
import torch

from scoup.scene.rotations import quats_of_rotations


def rotation_from_quat(quat: np.ndarray) -> np.ndarray | None:
    """Return the rotation [3, 3] float64 of a quaternion (w, x, y, z) of any norm; None if that is 0 or infinite."""
    largest = np.abs(quat).max()
    if not 0 < largest < np.inf:
        return None
    scaled = quat / largest
    w, x, y, z = scaled / np.linalg.norm(scaled)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def quat_from_rotation(rotation: np.ndarray) -> np.ndarray:
    """Return [4] float64 unit quaternion (w, x, y, z) of a rotation [3, 3]."""
    return quats_of_rotations(torch.from_numpy(rotation)[None])[0].numpy()


def rotated_quats(quats: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Return quaternions [N, 4] (w, x, y, z) turned by a rotation [3, 3]: float32."""
    a, b, c, d = quat_from_rotation(rotation)
    left = np.array([[a, -b, -c, -d], [b, a, -d, c], [c, d, a, -b], [d, -c, b, a]])
    with np.errstate(all="ignore"):
        return (quats.astype(np.float64) @ left.T).astype(np.float32)


def rotated_sh(sh: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Return coefficients [N, B, 3] of colours that are turned with the Gaussians: float32, B = 1, 4, 9 or 16.

    The colour seen along a direction d becomes the one that was seen along the direction that turns to d. Within a
    degree this is a linear map; it follows from the basis at directions before and after turning.
    """
    if sh.shape[1] == 1:
        return sh
    directions = _directions()
    before, after = sh_basis(directions @ rotation), sh_basis(directions)
    turned = [sh[:, :1].astype(np.float32)]
    for degree in range(1, int(sh.shape[1] ** 0.5)):
        part = slice(degree * degree, (degree + 1) ** 2)
        matrix = np.linalg.lstsq(after[:, part], before[:, part], rcond=None)[0]
        with np.errstate(all="ignore"):
            turned.append(np.einsum("ij,njc->nic", matrix, sh[:, part].astype(np.float64)).astype(np.float32))
    return np.concatenate(turned, axis=1)


def sh_basis(directions: np.ndarray) -> np.ndarray:
    """Return [M, 16] float64 real spherical harmonics with the signs of 3DGS, which are those of
    KHR_gaussian_splatting.
    """
    x, y, z = directions.T
    xx, yy, zz = x * x, y * y, z * z
    columns = [
        np.full_like(x, 0.28209479177387814),
        -0.4886025119029199 * y,
        0.4886025119029199 * z,
        -0.4886025119029199 * x,
        1.0925484305920792 * x * y,
        -1.0925484305920792 * y * z,
        0.31539156525252005 * (2 * zz - xx - yy),
        -1.0925484305920792 * x * z,
        0.5462742152960396 * (xx - yy),
        -0.5900435899266435 * y * (3 * xx - yy),
        2.890611442640554 * x * y * z,
        -0.4570457994644658 * y * (4 * zz - xx - yy),
        0.3731763325901154 * z * (2 * zz - 3 * xx - 3 * yy),
        -0.4570457994644658 * x * (4 * zz - xx - yy),
        1.445305721320277 * z * (xx - yy),
        -0.5900435899266435 * x * (xx - 3 * yy),
    ]
    return np.stack(columns, axis=1)


def _directions(count: int = 64) -> np.ndarray:
    """Return [count, 3] unit vectors, spread evenly in a spiral."""
    steps = np.arange(count) + 0.5
    height, angle = 1 - 2 * steps / count, steps * np.pi * (1 + 5**0.5)
    width = np.sqrt(1 - height**2)
    return np.stack([width * np.cos(angle), width * np.sin(angle), height], axis=1)
