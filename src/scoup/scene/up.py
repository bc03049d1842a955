"""The direction that is up in a scene, from its cameras, or from a splat without cameras."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import torch
from torch import Tensor

from scoup.base import InputError
from scoup.scene.cameras import Camera

UPRIGHT = 0.01  # how much the cameras' own up counts beside their right sides being level


def checked_direction(up: Sequence[float]) -> Tensor:
    """Return [3] float64, the unit vector of a direction.

    Raises:
        InputError: it is none.
    """
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
