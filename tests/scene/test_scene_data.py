"""Gaussians, cameras and regions: what they refuse, and how they are found and resized."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from scoup.base import InputError, UnknownNameError
from scoup.base.errors import nearest_names
from scoup.scene.cameras import Camera, Cameras
from scoup.scene.regions import RegionMap, Regions, resize_labels
from support import make_camera, random_gaussians, small_scene, unit


@pytest.mark.parametrize(("field", "value"), [
    ("means", torch.zeros(3, 2)), ("quats", torch.zeros(4, 4)), ("opacities", torch.zeros(3, 1)),
    ("sh", torch.zeros(3, 5, 3)),
    ("scales", torch.zeros(3, 3, dtype=torch.float64)),
])  # fmt: skip
def test_gaussians_refuse_wrong_parts(field, value):
    with pytest.raises(InputError, match=field):
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


@pytest.mark.parametrize(("changes", "message"), [
    ({"width": 0}, "size"),
    ({"viewmat": torch.eye(3)}, "viewmat"),
    ({"K": torch.diag(torch.tensor([-1.0, 1.0, 1.0]))}, "focal"),
    ({"viewmat": torch.full((4, 4), torch.nan)}, "finite"),
    ({"viewmat": torch.diag(torch.tensor([2.0, 2.0, 2.0, 1.0]))}, "determinant"),
])  # fmt: skip
def test_cameras_refuse_what_is_no_camera(changes, message):
    with pytest.raises(InputError, match=message):
        dataclasses.replace(make_camera(), **changes)


@pytest.mark.parametrize("width", [640, 640.0, np.int32(640), np.float32(640), torch.tensor(640)])
def test_sizes_are_whole_numbers_of_any_type(width):
    made = dataclasses.replace(make_camera(), width=width, height=width)
    assert (made.width, type(made.width), type(made.height)) == (640, int, int)
    assert made.fingerprint() == dataclasses.replace(make_camera(), width=640, height=640).fingerprint()


@pytest.mark.parametrize("bad", [480.5, float("nan"), float("inf"), "480", None, [480]])
def test_other_sizes_are_refused(bad):
    with pytest.raises(InputError, match=r"view\.png': height .* is not a whole number of pixels"):
        dataclasses.replace(make_camera(), height=bad)


def test_cameras_are_found_by_position_name_and_stem():
    cameras = Cameras([make_camera(name="a/frame_1.jpg"), make_camera(name="a/frame_2.jpg")])
    assert cameras[0] is cameras["a/frame_1.jpg"] is cameras["frame_1"]
    assert cameras[1:].names == ("a/frame_2.jpg",)
    assert cameras.select(["frame_2"]).names == ("a/frame_2.jpg",)
    assert cameras.select(lambda camera: "1" in camera.name).names == ("a/frame_1.jpg",)
    with pytest.raises(UnknownNameError, match="frame_1"):
        cameras["frame_3"]
    with pytest.raises(InputError, match="unique"):
        Cameras([make_camera(), make_camera()])


def test_resized_camera_sees_the_same_rays():
    camera = make_camera(40, 30, seed=1)
    half = camera.resized(20, 15)
    point = torch.tensor([0.3, -0.2, 2.0], dtype=torch.float64)
    full, small = camera.K @ point, half.K @ point
    assert torch.allclose(small[:2] / small[2] * 2, full[:2] / full[2])
    assert (Cameras([camera]).scaled(0.5)[0].width, camera.stem) == (20, "view")


def test_camera_position():
    camera = make_camera(seed=5)
    at_camera = camera.viewmat[:3, :3] @ camera.position + camera.viewmat[:3, 3]
    assert torch.allclose(at_camera, torch.zeros(3, dtype=torch.float64), atol=1e-12)


def test_pose_in_the_world_gives_the_same_camera():
    camera = make_camera(seed=5)
    pose = torch.linalg.inv(camera.viewmat)
    for given_pose in (pose, pose[:3], pose.tolist()):
        back = Camera.from_c2w("a.png", given_pose, camera.K, camera.width, camera.height)
        assert torch.allclose(back.viewmat, camera.viewmat, atol=1e-12)
        assert torch.allclose(back.position, pose[:3, 3], atol=1e-12)
    assert torch.equal(back.K, camera.K)
    with pytest.raises(InputError, match="c2w"):
        Camera.from_c2w("a.png", pose[:3, :3], camera.K, 4, 4)
    with pytest.raises(InputError, match="determinant"):
        Camera.from_c2w("a.png", pose * 2, camera.K, 4, 4)


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
    right, down, forward = camera.viewmat[:3, :3].tolist()
    assert right == pytest.approx([1, 0, 0])
    assert down == pytest.approx([0, 0, -1])
    assert forward == pytest.approx([0, 1, 0])


@pytest.mark.parametrize("up", [[0, -1, 0], [0, -7, 0], [0.3, -1, 0.9]])
def test_look_at_turns_up_to_the_top_of_the_image(up):
    camera = Camera.look_at([1, 2, 3], [1, 2, 4], "a.png", 40, 30, 35.0, up)
    rotation = camera.viewmat[:3, :3]
    seen = rotation @ torch.tensor(up, dtype=torch.float64)
    assert seen[0] == pytest.approx(0, abs=1e-12)
    assert seen[1] < 0  # image rows run downwards
    assert torch.allclose(rotation @ rotation.T, torch.eye(3, dtype=torch.float64), atol=1e-12)


@pytest.mark.parametrize(("eye", "target", "up", "message"), [
    ([1, 2, 3], [1, 2, 3], [0, 0, 1], "direction"),
    ([1, 2, 3], [1, 2, float("nan")], [0, 0, 1], "direction"),
    ([1, 2, 3], [1, 2, 4], [0, 0, 0], "direction"),
    ([1, 2, 3], [1, 2, 9], [0, 0, 1], "parallel"),
    ([1, 2, 3], [1, 2, -9], [0, 0, 1], "parallel"),
])  # fmt: skip
def test_look_at_refuses_degenerate_directions(eye, target, up, message):
    with pytest.raises(InputError, match=message):
        Camera.look_at(eye, target, "a.png", 40, 30, 35.0, up)


@given(st.integers(1, 20), st.integers(1, 20), st.integers(1, 40), st.integers(1, 40))
def test_labels_are_resized_to_the_nearest_pixel(rows, columns, height, width):
    labels = torch.arange(rows * columns, dtype=torch.int32).view(rows, columns)
    resized = resize_labels(labels, width, height)
    for y in range(height):
        for x in range(width):
            # Where the middle of a pixel falls on a border, either side is as near.
            near_rows = {(2 * y + 1) * rows // (2 * height), -(-(2 * y + 1) * rows // (2 * height)) - 1}
            near_columns = {
                (2 * x + 1) * columns // (2 * width),
                -(-(2 * x + 1) * columns // (2 * width)) - 1,
            }
            near = {int(labels[row, column]) for row in near_rows for column in near_columns}
            assert int(resized[y, x]) in near


def test_region_maps_refuse_labels_without_embedding():
    with pytest.raises(InputError, match="0 to 3"):
        RegionMap(torch.tensor([[0, 3]], dtype=torch.int32), unit(torch.randn(3, 4)))
    with pytest.raises(InputError, match="-2"):
        RegionMap(torch.tensor([[-2, 0]], dtype=torch.int32), unit(torch.randn(3, 4)))
    with pytest.raises(InputError, match="finite"):
        RegionMap(torch.tensor([[0]], dtype=torch.int32), torch.full((1, 4), torch.nan))


def test_regions_stack_in_view_order():
    _, cameras, regions = small_scene(views=3, regions=4)
    stacked, rows = regions.embeddings("m")
    assert len(stacked) == 12
    assert rows[cameras[1].name] == slice(4, 8)
    assert torch.equal(stacked[4:8], regions.load(cameras[1].name, "m").embeddings)
    assert len(regions.select([cameras[2].name])) == 1
    with pytest.raises(UnknownNameError, match="view_00"):
        regions.load("view_09.png", "m")
    with pytest.raises(UnknownNameError, match="level"):
        regions.load(cameras[0].name, "xl")


def test_regions_of_two_models_do_not_mix():
    labels = torch.zeros(2, 2, dtype=torch.int32)
    maps = {name: {"m": RegionMap(labels, torch.ones(1, dim))} for name, dim in (("a", 4), ("b", 5))}
    with pytest.raises(InputError, match="mix models"):
        Regions.from_maps(maps).embeddings("m")


def test_nearest_names():
    assert nearest_names("ketle", ["kettle", "mug", "table"])[0] == "kettle"
    assert nearest_names("x", []) == []


def test_camera_keeps_float64():
    camera = Camera("a", torch.eye(4), torch.tensor([[5.0, 0, 2], [0, 5, 2], [0, 0, 1]]), 4, 4)
    assert camera.viewmat.dtype == camera.K.dtype == torch.float64
