"""Directions of a scene, from cameras held level or looking straight down, and cameras on the way."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from messages import refuses
from query.planted_room import FRONT, Box, planted_room
from scoup.base import WorldFrame
from scoup.query.drawings import MOST_STOPS, camera_path, turntable
from scoup.scene import Camera, Cameras, estimate_up
from support import examples

UPRIGHT = WorldFrame(up=(0, 0, 2))


def rolled(camera: Camera, degrees: float) -> Camera:
    """The camera turned about its own direction of view."""
    turn = torch.eye(4, dtype=torch.float64)
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    turn[:2, :2] = torch.tensor([[c, -s], [s, c]])
    return replace(camera, viewmat=turn @ camera.viewmat)


def looking_down(name: str, degrees: float = 0.0) -> Camera:
    """Its image's top is towards +y where it is not turned."""
    return rolled(Camera.look_at((0, 0, 5), (0, 0, 0), name, 64, 48, 50, up=(0, 1, 0)), degrees)


def degrees_between(one: Tensor, other: Tensor) -> float:
    return math.degrees(math.acos(min(1.0, float(one @ other))))


@settings(max_examples=examples(60), deadline=None)
@given(seed=st.integers(0, 9999), highest=st.sampled_from([0.3, 2.0, 6.0]), count=st.integers(8, 20))
def test_level_cameras_tell_up_within_a_degree(seed, highest, count) -> None:
    """Cameras around a scene, each held level within a degree, at any height; the world is turned anyhow."""
    rng = np.random.default_rng(seed)
    side, cameras = np.linalg.qr(rng.normal(size=(3, 3)))[0], []
    up = side[:, 0]
    for place in range(count):
        angle = 2 * np.pi * place / count + rng.uniform(0, 0.2)
        eye = side @ [rng.uniform(0, highest), 3 * np.cos(angle), 3 * np.sin(angle)]
        camera = Camera.look_at(eye, rng.uniform(-0.2, 0.2, 3), "a.png", 64, 48, 50, up=up)
        cameras.append(rolled(camera, rng.uniform(-1, 1)))
    assert degrees_between(estimate_up(cameras), torch.from_numpy(up)) < 1.0


def test_cameras_side_by_side_tell_up_by_their_images() -> None:
    assert degrees_between(estimate_up([FRONT, FRONT]), torch.tensor([0, 0, 1.0]).double()) < 0.01
    looking_up = Camera.look_at((0, -5, 0), (0, 0, 8), "tower.png", 64, 48, 50)
    assert estimate_up([looking_up, Camera.look_at((5, 0, 0), (0, 0, 8), "a.png", 64, 48, 50)])[2] > 0.99


@pytest.mark.parametrize("turned", [0, 40, 90, 215])
def test_cameras_that_look_straight_down_look_from_above(turned) -> None:
    cameras = [looking_down(f"{step}.png", turned + 90 * step) for step in range(4)]
    assert float(estimate_up(cameras)[2]) > 0.999


def test_where_a_camera_looks_along_up_its_image_says_what_is_right_and_away() -> None:
    down = planted_room([Box("ball", (0, 0, 0), (1, 1, 1))], [looking_down("drone.png")])
    axes = down.with_world(UPRIGHT).frame("drone.png").axes
    torch.testing.assert_close(axes, torch.tensor([[1.0, 0, 0], [0, 0, 1], [0, 1, 0]]).double())
    for ahead in (0.0, 0.5):
        camera = Camera.look_at((0, 0, 0), (ahead, 0, 5), "sky.png", 64, 48, 50, up=(-1, 0, 0))
        ball = planted_room([Box("ball", (0, 0, 4), (1, 1, 1))], [camera])
        frame = ball.with_world(UPRIGHT).frame("sky.png")
        torch.testing.assert_close(frame.axes[0], camera.viewmat[0, :3])


def test_axes_are_orthonormal_and_told() -> None:
    field = planted_room()
    aside = Camera.look_at((4, -4, 3), (0, 0, 1), "aside.png", 64, 48, 50)
    frame = field.frame(aside)
    torch.testing.assert_close(frame.axes @ frame.axes.T, torch.eye(3).double())
    expected = torch.tensor([[0.5**0.5, 0.5**0.5, 0], [0, 0, 1], [-(0.5**0.5), 0.5**0.5, 0]]).double()
    torch.testing.assert_close(frame.axes, expected)
    assert frame.to_dict()["seen_from"] == "aside.png"
    assert frame.describe().startswith("left, right, front and back as seen from aside.png; up is [0, 0, 1]")
    assert field.with_world(UPRIGHT).frame().up_source == "of the field's frame"


def test_the_camera_that_sees_most_is_the_viewer() -> None:
    narrow = Camera.look_at((0, -5, 1), (30, 0, 1), "narrow.png", 64, 48, 500)
    assert planted_room(cameras=[narrow, FRONT]).frame().seen_from == FRONT.name
    alone = planted_room()
    alone.cameras = None
    assert estimate_up(()).tolist() == [0, 0, 1]
    assert (alone.frame().seen_from, alone.frame().axes[1].tolist()) == ("", [0, 0, 1])


def test_what_is_no_direction_is_refused() -> None:
    for up in ((0, 0, 0), (1, 2), (math.nan, 0, 1), (math.inf, 0, 0)):
        with refuses():
            WorldFrame.of_header({"frame": {"up": up}})


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
