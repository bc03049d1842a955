"""The z-buffer behind the ground truth, against shapes whose silhouettes are known."""

from __future__ import annotations

import numpy as np
import torch

from scoup.scene import Camera
from scoup_lab.synthetic.art.zbuffer import visible_faces
from synthetic.shapes import half_turn, rectangle, sphere


def camera(width: int = 97, height: int = 71, focal: float = 80.0) -> Camera:
    """At the origin, looking along +z, with its principal point off the middle."""
    intrinsics = torch.tensor([[focal, 0, width / 2 + 3.3], [0, focal, height / 2 - 2.1], [0, 0, 1]])
    return Camera("view.png", torch.eye(4), intrinsics, width, height)


def rays(view: Camera) -> np.ndarray:
    """[H, W, 3] directions through the pixel centres; z = 1."""
    y, x = np.mgrid[: view.height, : view.width] + 0.5
    return np.stack([(x - view.cx) / view.fx, (y - view.cy) / view.fy, np.ones_like(x)], -1)


def test_sphere_is_seen_where_rays_hit_it():
    view, centre, radius = camera(), np.array([0.3, -0.2, 4.0]), 1.1
    ball = sphere(radius, centre, segments=160)
    seen = visible_faces(ball.vertices, ball.faces, view) >= 0
    ray = rays(view)
    along = ray @ centre
    truth = along**2 - (ray**2).sum(-1) * (centre @ centre - radius**2) > 0
    # The mesh lies inside the sphere by a thousandth of its radius: some pixels of its rim may differ.
    assert (seen & ~truth).sum() == 0
    assert (truth & ~seen).sum() <= 0.01 * truth.sum()


def test_faces_seen_from_behind_or_behind_the_camera_are_not_drawn():
    view = camera()
    wall = rectangle((-1, -1, 3), (0, 2, 0), (2, 0, 0))
    assert (visible_faces(wall.vertices, wall.faces, view) >= 0).any()
    assert (visible_faces(wall.vertices, wall.faces[:, ::-1], view) < 0).all()
    behind = wall.moved((0, 0, 0), half_turn())
    assert (visible_faces(behind.vertices, behind.faces, view) < 0).all()
