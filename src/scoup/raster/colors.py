"""Colours of Gaussians as a camera sees them."""

from __future__ import annotations

import torch
from torch import Tensor

from scoup.scene import SH_C0, Camera, Gaussians, sh_basis


def view_colors(gaussians: Gaussians, camera: Camera) -> Tensor:
    """Return [N, 3] float32 RGB of every Gaussian seen from the camera, max(0, SH(direction) + 0.5)."""
    colors = SH_C0 * gaussians.sh[:, 0] + 0.5
    if gaussians.sh_degree > 0:
        position = camera.position.float().to(gaussians.device)
        directions = torch.nn.functional.normalize(gaussians.means - position, dim=1)
        basis = sh_basis(directions, gaussians.sh_degree)
        colors = colors + torch.einsum("nb,nbc->nc", basis, gaussians.sh[:, 1:])
    return colors.clamp(min=0)
