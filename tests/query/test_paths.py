"""Cameras on the way."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import torch

from messages import refuses
from scoup.query.paths import MOST_STOPS, camera_path, turntable
from scoup.scene import Camera, Cameras

SIDES = np.linalg.qr([[0.2, 1.0, 0.3], [-0.9, 0.0, 0.4], [0.4, 0.0, 1.0]])[0].T
UP = SIDES[0]


def ring(count: int, share: float = 1.0) -> Cameras:
    """Cameras on a part of a circle about a tilted axis, looking down at its middle."""
    angles = 2 * math.pi * share * np.arange(count) / count
    places = [[0.6, math.cos(angle), math.sin(angle)] @ SIDES for angle in angles]
    return Cameras(
        Camera.look_at(place, np.zeros(3), f"{number:03d}.png", 40, 30, 35.0, UP)
        for number, place in enumerate(places)
    )


def test_a_path_begins_and_ends_at_the_cameras_and_leads_through_them() -> None:
    cameras = ring(6, 0.6)
    path = camera_path(cameras, 101)
    assert len(path) == 101
    for end, camera in ((path[0], cameras[0]), (path[100], cameras[5])):
        assert torch.allclose(end.viewmat, camera.viewmat, atol=1e-9)
    places = torch.stack([camera.position for camera in path])
    for camera in cameras:
        assert float((places - camera.position).norm(dim=1).min()) < 0.02
    steps = (places[1:] - places[:-1]).norm(dim=1)
    assert float(steps.max()) < 3 * float(steps.mean())
    assert len(set(path.names)) == 101
    assert (path[7].width, path[7].height, path[7].fx) == (40, 30, 35.0)


def test_paths_of_many_or_one_camera() -> None:
    assert len(camera_path(ring(3 * MOST_STOPS), 10)) == 10
    (one,) = ring(1)
    for same in (ring(1), Cameras(replace(one, name=f"{number}.png") for number in range(3))):
        found = torch.stack([camera.viewmat for camera in camera_path(same, 9)])
        assert torch.allclose(found, one.viewmat.expand(9, 4, 4))
    for cameras, count in ((Cameras([]), 5), (ring(3), 0)):
        with refuses():
            camera_path(cameras, count)


def test_a_turntable_keeps_distance_and_height() -> None:
    camera, centre, up = ring(5)[2], torch.tensor([0.1, 0.2, -0.1]).double(), torch.from_numpy(UP)
    cameras = turntable(camera, centre.numpy(), UP, 8)
    arms = torch.stack([each.position for each in cameras]) - centre
    assert torch.allclose(arms[0], camera.position - centre)
    assert torch.allclose(arms.norm(dim=1), arms[0].norm().expand(8))
    assert torch.allclose(arms @ up, (arms[0] @ up).expand(8))
    for each in cameras:
        seen = each.viewmat[:3, :3] @ centre + each.viewmat[:3, 3]
        assert torch.allclose(seen[:2], torch.zeros(2, dtype=torch.float64), atol=1e-9)
        assert seen[2] > 0
    assert torch.allclose(arms[4] + arms[0], 2 * (arms[0] @ up) * up)  # half a turn


def test_what_a_camera_cannot_turn_around_is_refused() -> None:
    camera = Camera.look_at((0, 0, 0), (1, 0, 0), "a.png", 4, 3, 5.0)
    for centre in ((0, 0, 0), (0, 0, 3)):
        with refuses():
            turntable(camera, centre, (0, 0, 1), 5)
