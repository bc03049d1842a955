"""A picture of an edit: the scene before it, what was selected, and the scene after it."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from scoup import raster
from scoup.base.counts import counted, spread
from scoup.base.errors import InputError
from scoup.pictures import as_picture, contact_sheet, mask_overlay
from scoup.pictures.colors import Picture
from scoup.query.coded_scene import CodedScene
from scoup.scene.cameras import Camera
from scoup.scene.gaussians import Gaussians

MOST_TRIED = 12  # cameras from which the one that sees most of a selection is chosen
TRIED_SIDE = 160  # pixels of their longer side
COVERED = 0.5  # share of a pixel's light from which it belongs to the selection


def edit_picture(field: CodedScene, after: Gaussians, mask: Tensor, camera: Camera, title: str) -> Picture:
    """Draw before, selection [N] boolean and after beside each other, [H, W, 3] uint8."""
    projection = field.project(camera)
    before = raster.render_colors(field.gaussians, camera, projection).cpu()
    inside = _share_of(field, projection, mask) > COVERED
    later = torch.zeros(camera.height, camera.width, 3)
    if len(after):
        later = raster.render_colors(after, camera, raster.project(after, camera, field.raster_preset)).cpu()
    tiles = [as_picture(before), mask_overlay(inside, before), as_picture(later)]
    heading = f"{title}: {int(mask.sum()):,} of {counted(len(mask), 'Gaussian')}"
    return contact_sheet(tiles, ("before", "selected", "after"), 3, 1500, heading)


def best_camera(field: CodedScene, mask: Tensor, cameras: Sequence[Camera]) -> Camera:
    """Return the camera in which a selection [N] takes the largest share, of at most ``MOST_TRIED``, evenly spread."""
    if not cameras:
        raise InputError("no camera to draw a picture with; pass at least one")
    shares: list[tuple[float, Camera]] = []
    for camera in spread(cameras, MOST_TRIED):
        scale = min(1.0, TRIED_SIDE / max(camera.width, camera.height))
        small = camera.resized(max(1, round(camera.width * scale)), max(1, round(camera.height * scale)))
        shares.append((float(_share_of(field, field.project(small), mask).mean()), camera))
    return max(shares, key=lambda pair: pair[0])[1]


def _share_of(field: CodedScene, projection: raster.Projection, mask: Tensor) -> Tensor:
    """The share of each pixel that the Gaussians in a mask [N] contribute, [H, W] on the CPU."""
    values = mask[:, None].float().to(field.codebook.device)
    return raster.render_values(projection, values)[..., 0].cpu()
