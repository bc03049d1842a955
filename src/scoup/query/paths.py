"""Cameras on the way: from view to view, or around a thing."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from scoup.base import InputError, spread
from scoup.scene import Camera, Cameras

MOST_STOPS = 40  # cameras that a path leads through


def camera_path(cameras: Cameras, count: int) -> Cameras:
    """Return ``count`` cameras on a smooth path through those of a scene (of more than ``MOST_STOPS`` so many, evenly
    spread), in the order of their names, with the lens of the first."""
    from scipy.interpolate import PchipInterpolator
    from scipy.spatial.transform import Rotation, Slerp

    if not len(cameras) or count < 1:
        raise InputError(f"a path of {count} cameras through {len(cameras)} is not possible")
    stops = spread(list(cameras), MOST_STOPS)
    first = stops[0]
    if len(stops) == 1:
        return Cameras(replace(first, name=_name(number), image_path=None) for number in range(count))
    places = np.stack([camera.position.numpy() for camera in stops])
    turns = Rotation.from_matrix(np.stack([camera.viewmat[:3, :3].numpy().T for camera in stops]))
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    # Times follow distances, so that the speed is even; a camera that only turns takes its time, too.
    times = np.concatenate([[0.0], np.cumsum(np.maximum(steps, 0.2 * (steps.mean() or 1.0)))])
    moments = np.linspace(0, times[-1], count)
    between, turned = PchipInterpolator(times, places)(moments), Slerp(times, turns)(moments).as_matrix()
    poses = np.concatenate([turned, between[:, :, None]], axis=2)
    size = (first.width, first.height)
    return Cameras(Camera.from_c2w(_name(number), pose, first.K, *size) for number, pose in enumerate(poses))


def turntable(camera: Camera, centre: Tensor | ArrayLike, up: Tensor | ArrayLike, count: int) -> Cameras:
    """Return ``count`` cameras, evenly on a circle around a point [3] and a direction ``up`` [3], which all look at it,
    with the lens and distance of one; they begin there."""
    from scipy.spatial.transform import Rotation

    point, axis = (torch.as_tensor(vector, dtype=torch.float64).numpy() for vector in (centre, up))
    arm = camera.position.numpy() - point
    length = np.linalg.norm(axis)
    if (
        count < 1
        or not length > 0
        or not np.linalg.norm(np.cross(arm, axis)) > 1e-6 * np.linalg.norm(arm) * length
    ):
        raise InputError(
            f"{count} cameras cannot turn around {point.tolist()} from {camera.position.tolist()}"
        )
    angles = np.arange(count) * (2 * math.pi / count)
    arms = Rotation.from_rotvec(angles[:, None] * (axis / length)).apply(arm)
    size = (camera.width, camera.height)
    return Cameras(
        Camera.look_at(point + arm, point, _name(number), *size, camera.fy, axis)
        for number, arm in enumerate(arms)
    )


def _name(number: int) -> str:
    return f"frame_{number:05d}.png"
