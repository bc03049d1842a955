"""Projection of 3D Gaussians to image-plane Gaussians (EWA splatting), in float64.

Double precision costs little here (one pass over N) and buys a reference whose error is that of the per-pixel
evaluation alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from scoup.raster.presets import ALPHA_MIN, LOW_PASS, RasterPreset
from scoup.scene import Camera, Gaussians, rotation_matrices


@dataclass(frozen=True, eq=False)
class ProjectedGaussians:
    """The M Gaussians a camera may see, nearest first (equal depths in the order of their index); float64."""

    ids: Tensor  # [M] int64 row of each in the scene
    means2d: Tensor  # [M, 2] centre in pixels
    depths: Tensor  # [M] view-space z in world units
    covariances: Tensor  # [M, 3] (xx, xy, yy) of the 2D covariance in square pixels, low-pass included
    determinants: Tensor  # [M] of the 2D covariance
    opacities: Tensor  # [M] peak alpha, 1/255 to 1

    def __len__(self) -> int:
        return self.ids.shape[0]

    def extents(self) -> Tensor:
        """Return [M, 2] half width and height in pixels of the ellipse where alpha = 1/255."""
        radius2 = 2.0 * torch.log(self.opacities / ALPHA_MIN)
        return torch.sqrt(radius2[:, None].clamp(min=0) * self.covariances[:, [0, 2]])


def project_gaussians(gaussians: Gaussians, camera: Camera, preset: RasterPreset) -> ProjectedGaussians:
    """Project, drop what cannot contribute to a pixel, and sort by depth.

    Dropped: rows that are not finite, zero quaternions, opacity under 1/255, depth at or before the near plane,
    ellipses that miss the image. Source: EWA splatting as in 3DGS; see docs/conventions.md for the constants.
    """
    viewmat = camera.viewmat.to(gaussians.device)
    alive = gaussians.finite() & (gaussians.opacities >= ALPHA_MIN) & (gaussians.quats != 0).any(1)
    ids = torch.nonzero(alive).squeeze(1)
    points = gaussians.means[ids].double() @ viewmat[:3, :3].T + viewmat[:3, 3]
    in_front = points[:, 2] > preset.near
    ids, points = ids[in_front], points[in_front]

    factor = _image_plane_factor(gaussians, ids, points, camera, preset)
    squares = (factor * factor).sum(2)
    xx, yy = squares[:, 0] + LOW_PASS, squares[:, 1] + LOW_PASS
    xy = (factor[:, 0] * factor[:, 1]).sum(1)
    # det(B B^T + c I) by its minors: a difference xx * yy - xy^2 would lose every digit of a needle.
    minors = torch.linalg.cross(factor[:, 0], factor[:, 1])
    determinants = (minors * minors).sum(1) + LOW_PASS * (squares[:, 0] + squares[:, 1]) + LOW_PASS**2
    focal = torch.tensor([camera.fx, camera.fy], dtype=torch.float64, device=points.device)
    principal = torch.tensor([camera.cx, camera.cy], dtype=torch.float64, device=points.device)
    # K may contain a skew term; Jacobians in the literature ignore it, and so does this one.
    means2d = points[:, :2] / points[:, 2:] * focal + principal
    projected = ProjectedGaussians(
        ids,
        means2d,
        points[:, 2],
        torch.stack([xx, xy, yy], 1),
        determinants,
        gaussians.opacities[ids].double().clamp(max=1.0),
    )
    size = torch.tensor([camera.width, camera.height], dtype=torch.float64, device=points.device)
    extents = projected.extents()
    touches = ((means2d + extents >= 0.5) & (means2d - extents <= size - 0.5)).all(1)
    order = torch.nonzero(touches).squeeze(1)
    order = order[torch.argsort(projected.depths[order], stable=True)]
    return ProjectedGaussians(*(column[order] for column in vars(projected).values()))


def _image_plane_factor(
    gaussians: Gaussians, ids: Tensor, points: Tensor, camera: Camera, preset: RasterPreset
) -> Tensor:
    """Return B [M, 2, 3] float64 with B B^T the 2D covariance before the low-pass: B = J W R S."""
    depth = points[:, 2]
    x_low, x_high, y_low, y_high = ray_limits(camera, preset)
    ray_x = (points[:, 0] / depth).clamp(x_low, x_high)
    ray_y = (points[:, 1] / depth).clamp(y_low, y_high)

    rotation = rotation_matrices(gaussians.quats[ids].double())
    axes = camera.viewmat.to(points.device)[:3, :3] @ (rotation * gaussians.scales[ids].double()[:, None, :])
    row_x = (axes[:, 0] - ray_x[:, None] * axes[:, 2]) * (camera.fx / depth)[:, None]
    row_y = (axes[:, 1] - ray_y[:, None] * axes[:, 2]) * (camera.fy / depth)[:, None]
    return torch.stack([row_x, row_y], 1)


def ray_limits(camera: Camera, preset: RasterPreset) -> tuple[float, float, float, float]:
    """Return the bounds (x low, x high, y low, y high) of x / z and y / z at which the Jacobian is taken."""
    tan_x, tan_y = 0.5 * camera.width / camera.fx, 0.5 * camera.height / camera.fy
    if preset.centred_clamp:
        return -1.3 * tan_x, 1.3 * tan_x, -1.3 * tan_y, 1.3 * tan_y
    return (
        -camera.cx / camera.fx - 0.3 * tan_x,
        (camera.width - camera.cx) / camera.fx + 0.3 * tan_x,
        -camera.cy / camera.fy - 0.3 * tan_y,
        (camera.height - camera.cy) / camera.fy + 0.3 * tan_y,
    )


def tile_counts(width: int, height: int, tile: int) -> tuple[int, int]:
    """Return the tiles across and down that cover the image."""
    return math.ceil(width / tile), math.ceil(height / tile)
