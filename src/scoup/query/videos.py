"""Videos of the relevancy of a scene to a text, frame by frame."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import torch
from torch import Tensor

from scoup import raster
from scoup.base.errors import InputError
from scoup.pictures import captioned, heat_overlay
from scoup.pictures.colors import Picture
from scoup.query.coded_scene import CodedScene
from scoup.query.edit_picture import best_camera
from scoup.query.place import Place
from scoup.scene.cameras import Camera, Cameras
from scoup.scene.paths import camera_path, turntable
from scoup.scene.up import estimate_up

Motion = Literal["path", "turntable"]
SHARE = 0.35  # of the picture's height for a thing on a turntable


def moving_cameras(field: CodedScene, place: Place, cameras: Cameras, motion: Motion, count: int) -> Cameras:
    """Return the cameras of a video with ``count`` frames.

    "path" leads through the cameras; "turntable" goes around the thing at ``place``, from the camera that sees most of
    it.
    """
    if motion == "path":
        return camera_path(cameras, count)
    if place.position is None or place.box is None:
        raise InputError(
            f"{place.answer.text}: is not in this scene, so there is nothing to turn around; use a path"
        )
    up = estimate_up(cameras)
    first = best_camera(field, place.answer.mask, list(cameras))
    size = float(place.box.extent.norm())
    arm = first.position - place.position
    length = float(arm.norm())
    near = size / SHARE / (first.height / first.fy)
    away = max(min(near, length), 0.75 * size) or length  # a single point has no size
    closer = Camera.look_at(
        place.position + arm * (away / max(length, 1e-12)),
        place.position,
        first.name,
        first.width,
        first.height,
        first.fy,
        up,
    )
    return turntable(closer, place.position, up, count)


def heat_frames(
    field: CodedScene, query: Tensor, canonical: Tensor, place: Place, cameras: Cameras
) -> Iterator[Picture]:
    """Yield heat maps of one text [D] beside canonical phrases [P, D], at the level of its answer and with one scale of
    colours, [H, W, 3] uint8 each.
    """
    answer = place.answer
    level = field.level_index(answer.level)
    known = field.gaussian_relevancy(query[None], canonical)[level, 0][field.coded_levels()[level]].cpu()
    span = (float(known.median()), float(known.max())) if len(known) else (0.0, 1.0)
    low = span[0]
    remark = f"level {answer.level}, {answer.remark()}"
    for camera in cameras:
        projection = field.project(camera)
        heat = field.relevancy(camera, query[None], canonical, projection)[level, 0].cpu()
        rgb = raster.render_colors(field.gaussians, camera, projection).cpu()
        yield captioned(heat_overlay(torch.nan_to_num(heat, low), rgb, span), answer.text, remark)
