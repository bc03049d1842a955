"""The depth of a view, and the position of a mask of it in the world."""

from __future__ import annotations

import weakref

import torch
from torch import Tensor

from scoup import raster
from scoup.query.coded_scene import CodedScene
from scoup.scene.cameras import Camera

LEAST_ALPHA = 0.5  # of a pixel with a depth


class ViewDepth:
    """The depth of a view, rendered at first use. The projection is not kept alive."""

    def __init__(self, field: CodedScene, camera: Camera, projection: raster.Projection) -> None:
        self._field, self._camera = field, camera
        self._projection = weakref.ref(projection)
        self._depth: Tensor | None = None

    def __call__(self) -> Tensor:
        """Return the depth, see ``view_depth``."""
        if self._depth is None:
            projection = self._projection() or self._field.project(self._camera)
            self._depth = view_depth(self._field, self._camera, projection)
        return self._depth

    def position(self, mask: Tensor) -> Tensor | None:
        """Return the position of a mask, see ``mask_position``."""
        return mask_position(mask, self(), self._camera)


def view_depth(field: CodedScene, camera: Camera, projection: raster.Projection) -> Tensor:
    """Return the mean distance along the view direction by blending weights, in world units, [H, W] float32 on the CPU;
    NaN where alpha is below ``LEAST_ALPHA``.
    """
    means = field.gaussians.means.double()
    row = camera.viewmat[2].to(means.device)
    distances = (means @ row[:3] + row[3]).float().nan_to_num(0.0, 0.0, 0.0)
    image, alpha = raster.render_channels(projection, distances[:, None])
    return torch.where(alpha >= LEAST_ALPHA, image[..., 0] / alpha.clamp(min=1e-9), torch.nan).cpu()


def mask_position(mask: Tensor, depth: Tensor, camera: Camera) -> Tensor | None:
    """Return the middle of the surface that a mask [H, W] shows, the median of its pixels along each axis, [3] float64
    world units; None if no pixel of the mask has a depth.
    """
    rows, columns = (mask.cpu() & torch.isfinite(depth)).nonzero().unbind(1)
    if not len(rows):
        return None
    distances = depth[rows, columns].double()
    (fx, _, cx), (_, fy, cy) = camera.K[0].tolist(), camera.K[1].tolist()
    seen = torch.stack([(columns + 0.5 - cx) / fx, (rows + 0.5 - cy) / fy, torch.ones(len(rows))], 1).double()
    rotation, shift = camera.viewmat[:3, :3], camera.viewmat[:3, 3]
    return ((seen * distances[:, None] - shift) @ rotation).median(0).values
