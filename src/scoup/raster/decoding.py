"""Values of codes at pixels: cosines from coefficients, and colours from spherical harmonics."""

from __future__ import annotations

import torch
from torch import Tensor

from scoup.scene import SH_C0, Camera, Gaussians, sh_basis


def cosines_from_codes(weights: Tensor, codebook: Tensor, queries: Tensor) -> Tensor:
    """Cosines between decoded codes and queries, without decoding (docs/method.md, stage 3).

    cos(W C, t) = (W A) / sqrt(W G W^T) with A = C T^T and G = C C^T.

    Args:
        weights: [..., L] coefficients over the atoms, in any scale.
        codebook: [L, D].
        queries: [Q, D], unit norm.

    Returns:
        [..., Q]; zero where the coefficients are all zero.
    """
    return cosines_and_norms(weights, codebook @ queries.T, codebook @ codebook.T)[0]


def cosines_and_norms(weights: Tensor, scores: Tensor, gram: Tensor) -> tuple[Tensor, Tensor]:
    """Return ``cosines_from_codes`` of coefficients [..., P, L], and the norms of the decoded codes [..., P],
    sqrt(W G W^T), from two products of codebook and queries: ``scores`` [..., L, Q], A = C T^T, and ``gram``
    [..., L, L], G = C C^T."""
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
