"""Gaussians, cameras and regions: what they refuse, and how they are found and resized."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from messages import refuses
from scoup.base import UnknownNameError
from scoup.base.errors import nearest_names
from scoup.scene.cameras import Camera, Cameras
from scoup.scene.regions import RegionMap, Regions, resize_labels
from support import make_camera, random_gaussians, small_scene


def test_gaussians_refuse_wrong_parts():
    for field, value in {
        "means": torch.zeros(3, 2), "quats": torch.zeros(4, 4), "opacities": torch.zeros(3, 1),
        "sh": torch.zeros(3, 5, 3), "scales": torch.zeros(3, 3, dtype=torch.float64),
    }.items():  # fmt: skip
        with refuses():
            dataclasses.replace(random_gaussians(3, 0), **{field: value})


def test_fingerprint_follows_geometry_not_colour():
    gaussians = random_gaussians(10, 0)
    recoloured = dataclasses.replace(gaussians, sh=gaussians.sh + 1)
    assert recoloured.fingerprint() == gaussians.fingerprint()
    moved = dataclasses.replace(gaussians, means=gaussians.means + 1e-6)
    assert moved.fingerprint() != gaussians.fingerprint()
    assert gaussians.select(torch.arange(9)).fingerprint() != gaussians.fingerprint()


def test_finite_rows():
    gaussians = random_gaussians(4, 0)
    gaussians.means[0, 1] = torch.nan
    gaussians.scales[1, 2] = torch.inf
    gaussians.opacities[2] = torch.inf
    assert gaussians.finite().tolist() == [False, False, True, True]


def test_cameras_refuse_what_is_no_camera():
    for field, values in {
        "width": [0], "K": [torch.diag(torch.tensor([-1.0, 1.0, 1.0]))],
        "viewmat": [torch.eye(3), torch.full((4, 4), torch.nan), torch.diag(torch.tensor([2.0, 2.0, 2.0, 1.0]))],
        "height": [480.5, float("nan"), float("inf"), "480", None, [480]],
    }.items():  # fmt: skip
        for value in values:
            with refuses():
                dataclasses.replace(make_camera(), **{field: value})


@pytest.mark.parametrize("width", [640, 640.0, np.int32(640), np.float32(640), torch.tensor(640)])
def test_sizes_are_whole_numbers_of_any_type(width):
    made = dataclasses.replace(make_camera(), width=width, height=width)
    assert (made.width, type(made.width), type(made.height)) == (640, int, int)
    assert made.fingerprint() == dataclasses.replace(make_camera(), width=640, height=640).fingerprint()


def test_cameras_are_found_by_position_name_and_stem():
    cameras = Cameras([make_camera(name="a/frame_1.jpg"), make_camera(name="a/frame_2.jpg")])
    assert cameras[0] is cameras["a/frame_1.jpg"] is cameras["frame_1"]
    assert cameras[1:].names == ("a/frame_2.jpg",)
    assert cameras.select(["frame_2"]).names == ("a/frame_2.jpg",)
    assert cameras.select(lambda camera: "1" in camera.name).names == ("a/frame_1.jpg",)
    with refuses(UnknownNameError):
        cameras["frame_3"]
    with refuses():
        Cameras([make_camera(), make_camera()])


def test_resized_camera_sees_the_same_rays():
    camera = make_camera(40, 30, seed=1)
    half = camera.resized(20, 15)
    point = torch.tensor([0.3, -0.2, 2.0], dtype=torch.float64)
    full, small = camera.K @ point, half.K @ point
    assert torch.allclose(small[:2] / small[2] * 2, full[:2] / full[2])
    assert (Cameras([camera]).scaled(0.5)[0].width, camera.stem) == (20, "view")


def test_pose_in_the_world_gives_the_same_camera():
    camera = make_camera(seed=5)
    pose = torch.linalg.inv(camera.viewmat)
    for given_pose in (pose, pose[:3], pose.tolist()):
        back = Camera.from_c2w("a.png", given_pose, camera.K.float(), camera.width, camera.height)
        assert torch.allclose(back.viewmat, camera.viewmat, atol=1e-12)
        assert torch.allclose(back.position, pose[:3, 3], atol=1e-12)
        assert back.viewmat.dtype == back.K.dtype == torch.float64
    assert torch.equal(back.K, camera.K.float().double())
    for wrong in (pose[:3, :3], pose * 2):
        with refuses():
            Camera.from_c2w("a.png", wrong, camera.K, 4, 4)


def test_look_at_puts_the_target_in_the_middle():
    eye, target = [1.0, -2.0, 1.5], [0.1, 0.2, 0.8]
    camera = Camera.look_at(eye, target, "a.png", 40, 30, 35.0)
    assert camera.position.tolist() == pytest.approx(eye)
    way = torch.tensor(target) - torch.tensor(eye)
    points = (
        torch.tensor(eye) + torch.tensor([[1.0], [-1.0], [0.1]]) * way + torch.tensor([[0.0], [0.0], [1.0]])
    )
    pixels, depths = camera.pixels(points)
    assert pixels[0].tolist() == pytest.approx((20, 15), abs=1e-4)
    assert depths[:2].tolist() == pytest.approx([float(way.norm()), -float(way.norm())])
    assert camera.shows(points).tolist() == [True, False, False]  # behind it, and beside its image
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (35, 35, 20, 15)


def test_look_at_has_opencv_axes():
    camera = Camera.look_at([0, 0, 0], [0, 5, 0], "a.png", 40, 30, 35.0)  # towards +y, z up
    axes = torch.tensor([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # right, down and forward
    torch.testing.assert_close(camera.viewmat[:3, :3].float(), axes)


@pytest.mark.parametrize("up", [[0, -1, 0], [0, -7, 0], [0.3, -1, 0.9]])
def test_look_at_turns_up_to_the_top_of_the_image(up):
    camera = Camera.look_at([1, 2, 3], [1, 2, 4], "a.png", 40, 30, 35.0, up)
    rotation = camera.viewmat[:3, :3]
    seen = rotation @ torch.tensor(up, dtype=torch.float64)
    assert seen[0] == pytest.approx(0, abs=1e-12)
    assert seen[1] < 0  # image rows run downwards
    assert torch.allclose(rotation @ rotation.T, torch.eye(3, dtype=torch.float64), atol=1e-12)


def test_look_at_refuses_degenerate_directions():
    for target, up in (
        ([1, 2, 3], [0, 0, 1]), ([1, 2, float("nan")], [0, 0, 1]), ([1, 2, 4], [0, 0, 0]), ([1, 2, 9], [0, 0, 1]),
        ([1, 2, -9], [0, 0, 1]),
    ):  # fmt: skip
        with refuses():
            Camera.look_at([1, 2, 3], target, "a.png", 40, 30, 35.0, up)


def nearest(place: int, size: int, labels: int) -> set[int]:
    """Where the middle of a pixel falls on a border, either side is as near."""
    middle = (2 * place + 1) * labels
    return {middle // (2 * size), -(-middle // (2 * size)) - 1}


@given(st.integers(1, 20), st.integers(1, 20), st.integers(1, 40), st.integers(1, 40))
def test_labels_are_resized_to_the_nearest_pixel(rows, columns, height, width):
    labels = torch.arange(rows * columns, dtype=torch.int32).view(rows, columns)
    resized = resize_labels(labels, width, height)
    for y in range(height):
        for x in range(width):
            row, column = divmod(int(resized[y, x]), columns)
            assert row in nearest(y, height, rows)
            assert column in nearest(x, width, columns)


def test_regions_stack_in_view_order():
    _, cameras, regions = small_scene(views=3, regions=4)
    stacked, rows = regions.embeddings("m")
    assert len(stacked) == 12
    assert rows[cameras[1].name] == slice(4, 8)
    assert torch.equal(stacked[4:8], regions.load(cameras[1].name, "m").embeddings)
    assert len(regions.select([cameras[2].name])) == 1
    for view, level in (("view_09.png", "m"), (cameras[0].name, "xl")):
        with refuses(UnknownNameError):
            regions.load(view, level)


def test_regions_of_two_models_do_not_mix():
    labels = torch.zeros(2, 2, dtype=torch.int32)
    maps = {name: {"m": RegionMap(labels, torch.ones(1, dim))} for name, dim in (("a", 4), ("b", 5))}
    with refuses():
        Regions.from_maps(maps).embeddings("m")


def test_nearest_names():
    assert nearest_names("ketle", ["kettle", "mug", "table"])[0] == "kettle"
    assert nearest_names("x", []) == []
