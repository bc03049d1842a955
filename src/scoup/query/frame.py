"""Directions of a scene: up, and left and front as seen from a camera."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from scoup.base import WorldFrame, brief, rounded_vector
from scoup.field import Field
from scoup.scene import Camera


@dataclass(frozen=True, eq=False)
class Frame:
    """Right, up and away from the viewer in a scene.

    Example:
        >>> field.frame("view_00.png").axes.shape
        torch.Size([3, 3])
    """

    axes: Tensor
    """[3, 3] float64 on the CPU: rows right, up and away, orthonormal, in world coordinates."""
    seen_from: str
    """Name of the camera that left, right, front and back are meant from; "" where no camera is known."""
    up_source: str
    """Where up comes from, in words."""
    world: WorldFrame
    """The frame of the field in the world."""

    __repr__ = brief

    def describe(self) -> str:
        """Return the directions in words, for people."""
        up = ", ".join(f"{value:g}" for value in rounded_vector(self.axes[1].tolist()))
        seen = f"left, right, front and back as seen from {self.seen_from}; " if self.seen_from else ""
        return f"{seen}up is [{up}], {self.up_source}"

    def to_dict(self) -> dict[str, Any]:
        """Return the frame as plain JSON values, rounded."""
        right, up, away = (rounded_vector(axis) for axis in self.axes.tolist())
        return {
            **self.world.to_dict(),
            "seen_from": self.seen_from,
            "right": right,
            "up": up,
            "away": away,
            "up_source": self.up_source,
        }


def scene_frame(field: Field, camera: Camera | str | int | None = None) -> Frame:
    """Return the directions that relations mean; ``LanguageField.frame`` documents it."""
    if camera is None:
        return field.kept((Frame, field.cameras), lambda: _made_frame(field, None))
    return _made_frame(field, camera)


def _made_frame(field: Field, camera: Camera | str | int | None) -> Frame:
    cameras, direction = list(field.cameras or ()), field.up()
    if field.world.up is not None:
        source = "of the field's frame"
    elif cameras:
        source = f"estimated from {len(cameras)} cameras"
    else:
        source = "assumed, for the field has no cameras"
    viewer = field.camera(camera) if camera is not None else _widest(field, cameras)
    if viewer is None:
        away = torch.eye(3, dtype=torch.float64)[int(direction.abs().argmin())]
    else:
        rotation = torch.as_tensor(viewer.viewmat)[:3, :3].double().cpu()
        away = rotation[2]
        if float(torch.linalg.cross(away, direction).norm()) < 1e-3:  # looking straight up or down
            away = rotation[1] if away @ direction > 0 else -rotation[1]
    away = away - (away @ direction) * direction
    away = away / away.norm()
    right = torch.linalg.cross(away, direction)
    return Frame(torch.stack([right, direction, away]), viewer.name if viewer else "", source, field.world)


def _widest(field: Field, cameras: Sequence[Camera]) -> Camera | None:
    """Return the camera with the largest share of the Gaussians in its image; of several the first."""
    if not cameras:
        return None
    means = field.gaussians.means[:: max(1, len(field) // 20_000)]
    return max(cameras, key=lambda camera: int(camera.shows(means).sum()))
