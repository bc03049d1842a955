"""Values of codes at pixels: cosines from coefficients, and colours from spherical harmonics."""

from __future__ import annotations

import torch
from torch import Tensor

from scoup.scene import SH_C0, Camera, Gaussians, sh_basis


def cosines_and_norms(weights: Tensor, scores: Tensor, gram: Tensor) -> tuple[Tensor, Tensor]:
    """Return the cosines [..., P, Q] of decoded codes with queries, (W A) / sqrt(W G W^T) (docs/method.md, stage 3),
    and the norms of the decoded codes [..., P], without decoding; zero where all coefficients W [..., P, L] are.
    ``scores`` [..., L, Q] are A = C T^T of a codebook C and queries T of unit norm, ``gram`` [..., L, L] is G = C C^T.
    """
    squared_norm = ((weights @ gram) * weights).sum(-1, keepdim=True)
    norm = torch.sqrt(squared_norm.clamp(min=torch.finfo(weights.dtype).tiny))
    cosines = torch.where(squared_norm > 0, (weights @ scores) / norm, 0.0)
    return cosines, torch.where(squared_norm > 0, norm, 0.0)[..., 0]


def view_colors(gaussians: Gaussians, camera: Camera) -> Tensor:
    """Return [N, 3] float32 RGB of every Gaussian seen from the camera, max(0, SH(direction) + 0.5)."""
    colors = SH_C0 * gaussians.sh[:, 0] + 0.5
    if gaussians.sh_degree > 0:
        position = camera.position.float().to(gaussians.device)
        directions = torch.nn.functional.normalize(gaussians.means - position, dim=1)
        basis = sh_basis(directions, gaussians.sh_degree)
        colors = colors + torch.einsum("nb,nbc->nc", basis, gaussians.sh[:, 1:])
    return colors.clamp(min=0)
