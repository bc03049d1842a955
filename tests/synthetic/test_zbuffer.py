"""The z-buffer behind the ground truth, against shapes whose silhouettes are known."""

from __future__ import annotations

import numpy as np
import torch

from scoup.scene import Camera
from scoup_lab.synthetic.art.meshes import merged
from scoup_lab.synthetic.art.zbuffer import draw, visible_faces
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


def test_nearest_of_two_tilted_planes_is_seen():
    view = camera()
    first = rectangle((-9, -9, 3.0), (0, 18, 0), (18, 0, 2.0))
    second = rectangle((-9, -9, 5.0), (0, 18, 0), (18, 0, -2.0))
    both = merged([first, second])
    faces = visible_faces(both.vertices, both.faces, view)
    ray = rays(view)
    depth_of_first = (3.0 + 1.0) / (1 - ray[..., 0] * 2 / 18)
    depth_of_second = (5.0 - 1.0) / (1 + ray[..., 0] * 2 / 18)
    clear = np.abs(depth_of_first - depth_of_second) > 1e-6
    assert ((faces < len(first.faces)) == (depth_of_first < depth_of_second))[clear].all()
    assert (faces >= 0).all()


def test_neighbouring_triangles_leave_no_gap_and_do_not_overlap():
    rng = np.random.default_rng(3)
    angles = np.sort(rng.uniform(0, 2 * np.pi, 40))
    fan = np.concatenate([[[50.0, 40.0]], 50 + 300 * np.stack([np.cos(angles), np.sin(angles)], 1)])
    faces = np.array([[0, 1 + k, 1 + (k + 1) % 40] for k in range(40)])
    number, _ = draw(fan, np.ones(len(fan)), faces, 100, 80)
    assert (number >= 0).all()


def test_faces_seen_from_behind_or_behind_the_camera_are_not_drawn():
    view = camera()
    wall = rectangle((-1, -1, 3), (0, 2, 0), (2, 0, 0))
    assert (visible_faces(wall.vertices, wall.faces, view) >= 0).any()
    assert (visible_faces(wall.vertices, wall.faces[:, ::-1], view) < 0).all()
    behind = wall.moved((0, 0, 0), half_turn())
    assert (visible_faces(behind.vertices, behind.faces, view) < 0).all()
