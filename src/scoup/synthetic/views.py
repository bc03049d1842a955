"""How a view of the demo is set up."""

from __future__ import annotations

import numpy as np
import torch

from scoup.scene.cameras import Camera
from scoup.synthetic.meshes import Floats

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
