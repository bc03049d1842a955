"""Where the demo is seen from."""

from __future__ import annotations

import numpy as np
import torch

from scoup.cameras import Camera, Cameras
from scoup.demo.meshes import Floats

TARGET = np.array([0.0, 0.02, 0.86])  # metres: just above the middle of the table
WIDEST = 58.0  # degrees: horizontal angle of view


def look_at(eye: Floats, target: Floats, name: str, width: int, height: int, angle: float = WIDEST) -> Camera:
    """A camera at ``eye`` [3] looking at ``target`` [3], z up; ``angle``: horizontal angle of view in
    degrees.
    """
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    viewmat = np.eye(4)
    viewmat[:3, :3] = np.stack([right, np.cross(forward, right), forward])
    viewmat[:3, 3] = -viewmat[:3, :3] @ eye
    focal = width / 2 / np.tan(np.radians(angle) / 2)
    intrinsics = torch.tensor([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]], dtype=torch.float64)
    return Camera(name, torch.from_numpy(viewmat), intrinsics, width, height)


def make_cameras(
    n_building: int, n_held_out: int, width: int, height: int, rng: np.random.Generator
) -> tuple[Cameras, Cameras]:
    """Cameras to build the field from, and others to judge it by: a swing around the table's open sides.

    Height and distance vary along the way, and each camera looks at its own point on the table. No held-out
    camera stands where a building camera does.
    """
    return (
        Cameras(_swing("view", n_building, 0.0, width, height, rng)),
        Cameras(_swing("held_out", n_held_out, 0.37, width, height, rng)),
    )


def _swing(
    kind: str, count: int, phase: float, width: int, height: int, rng: np.random.Generator
) -> list[Camera]:
    cameras = []
    for step in range(count):
        along = (step + 0.5) / count
        azimuth = np.radians(-122 + 132 * along + rng.uniform(-2, 2))
        rise = np.sin(2 * np.pi * (along * 3 + phase))
        distance = 1.42 + 0.2 * np.cos(2 * np.pi * (along * 2 + phase)) + 0.25 * along
        eye = np.array([distance * np.cos(azimuth), distance * np.sin(azimuth), 1.44 + 0.24 * rise])
        aim = TARGET + rng.uniform(-1, 1, 3) * [0.1, 0.08, 0.04]
        cameras.append(look_at(eye, aim, f"{kind}_{step:02d}.png", width, height))
    return cameras
