"""transforms.json and Inria's cameras.json and cfg_args."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from io_samples import camera_difference, save_images, some_cameras, transforms, write_inria_cameras
from messages import refuses, warns
from scoup.base.errors import FileFormatError, MissingFileError, ScoupWarning
from scoup.io.cameras.inria import latest_point_cloud, read_cfg_args, read_inria_cameras
from scoup.io.cameras.nerfstudio import read_transforms, write_transforms
from scoup.scene.cameras import Cameras


def test_transforms_round_trip(tmp_path):
    cameras = some_cameras(4)
    write_transforms(cameras, tmp_path / "transforms.json")
    assert camera_difference(cameras, read_transforms(tmp_path / "transforms.json")) < 1e-12
    bent = Cameras(replace(camera, distortion=(0.1, 0.0, 0.0, 0.01)) for camera in cameras)
    write_transforms(bent, tmp_path / "transforms.json", overwrite=True)
    with refuses(FileFormatError):
        read_transforms(tmp_path / "transforms.json")
    assert read_transforms(tmp_path / "transforms.json", "undistort")[0].distortion == (0.1, 0.0, 0.0, 0.01)


def test_inria_round_trip(tmp_path):
    cameras = some_cameras(4, centered=True)
    write_inria_cameras(cameras, tmp_path / "cameras.json")
    assert camera_difference(cameras, read_inria_cameras(tmp_path / "cameras.json")) < 1e-12


def test_opengl_axes_and_defaults(tmp_path):
    camera = read_transforms(transforms(tmp_path))[0]
    assert camera.name == "a.png"
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (30, 30, 16, 12)
    # A point in front of an OpenGL camera lies at negative z; OpenCV sees it at positive depth.
    seen = camera.viewmat.numpy() @ np.array([1.5, 2.25, -1.0, 1.0])
    np.testing.assert_allclose(seen, [0.5, -0.25, 4.0, 1.0])
    np.testing.assert_allclose(camera.position, [1, 2, 3])


def test_angle_of_view_and_frame_intrinsics(tmp_path):
    camera = read_transforms(transforms(tmp_path, fl_x=None, camera_angle_x=math.pi / 2))[0]
    assert camera.fx == pytest.approx(16)
    assert camera.fy == pytest.approx(16)
    path = transforms(tmp_path, frame={"fl_x": 40, "fl_y": 41, "w": 64, "h": 48, "cx": 30})
    with warns(ScoupWarning):
        camera = read_transforms(path)[0]
    assert (camera.fx, camera.fy, camera.cx, camera.cy, camera.width) == (40, 41, 30, 24, 64)
    camera = read_transforms(path, by_nerfstudio=True)[0]
    assert (camera.fx, camera.fy, camera.cx, camera.cy, camera.width) == (30, 41, 30, 12, 32)


def test_lens_settings_that_change_nothing(tmp_path):
    straight = {"is_fisheye": False, "latlong": None, "ftheta_p0": 0.0, "k3": 0.0, "camera_model": "pinhole"}
    assert not read_transforms(transforms(tmp_path, **straight))[0].distortion
    path = transforms(tmp_path, is_fisheye=True, frame={"is_fisheye": False, "file_path": "fisheye/a.png"})
    assert not read_transforms(path)[0].distortion
    path = transforms(tmp_path, frame={"distortion_params": [0.1, 0.2, 0, 0, 0.3, 0.4]})
    assert read_transforms(path, "undistort")[0].distortion == (0.1, 0.2, 0.3, 0.4)


def test_masks_of_photographs(tmp_path):
    save_images(some_cameras(1), tmp_path / "masks")
    (tmp_path / "a").mkdir()
    camera = read_transforms(transforms(tmp_path, frame={"mask_path": "masks/view_00.png"}))[0]
    assert camera.mask_path == tmp_path / "masks" / "view_00.png"
    for name in ("masks/none.png", "../masks/view_00.png"):
        with warns(ScoupWarning):
            assert read_transforms(transforms(tmp_path / "a", frame={"mask_path": name}))[0].mask_path is None
    save_images(some_cameras(1), tmp_path / "images")  # as instant-ngp names them
    (tmp_path / "images" / "view_00.png").rename(tmp_path / "images" / "a.png")
    save_images(some_cameras(1), tmp_path / "images")
    dynamic = (tmp_path / "images" / "view_00.png").rename(tmp_path / "images" / "dynamic_mask_a.png")
    assert read_transforms(transforms(tmp_path))[0].mask_path == dynamic


def test_image_gives_size_and_extension(tmp_path):
    cameras = some_cameras(1, width=20, height=10)
    save_images(cameras, tmp_path / "images")
    frame = {"file_path": "images/view_00"}
    path = transforms(tmp_path, frame=frame, w=None, h=None, fl_x=None, camera_angle_x=1.0)
    camera = read_transforms(path)[0]
    assert (camera.width, camera.height, camera.name) == (20, 10, "view_00.png")
    assert camera.image_path == tmp_path / "images" / "view_00.png"
    content = json.loads(path.read_text())
    content["frames"].append({**content["frames"][0], "file_path": "images/gone"})
    path.write_text(json.dumps(content))
    with warns(ScoupWarning):
        assert len(read_transforms(path)) == 1


def test_same_file_names_in_two_folders(tmp_path):
    path = transforms(tmp_path)
    content = json.loads(path.read_text())
    content["frames"].append({**content["frames"][0], "file_path": "other\\a.png"})
    path.write_text(json.dumps(content))
    assert read_transforms(path).names == ("images/a.png", "other/a.png")
    content["frames"].append(content["frames"][0])
    path.write_text(json.dumps(content))
    with refuses(FileFormatError):
        read_transforms(path)


def test_bad_json(tmp_path):
    path = tmp_path / "cameras.json"
    for text in ("", "[1, 2", "[1]", "{}", "[" * 100_000, '{"a": 1' + "0" * 5000 + "}", "\x00"):
        path.write_text(text)
        with refuses(FileFormatError):
            read_inria_cameras(path)
    path.write_bytes(b"\xff\x00[")
    with refuses(FileFormatError):
        read_inria_cameras(path)
    with pytest.raises(MissingFileError):
        read_inria_cameras(tmp_path / "none.json")


def test_cfg_args(tmp_path):
    path = tmp_path / "cfg_args"
    path.write_text(r"Namespace(sh_degree=3, source_path='C:\\data', images='images', eval=False)")
    expected = {"sh_degree": 3, "source_path": "C:\\data", "images": "images", "eval": False}
    assert read_cfg_args(path) == expected
    for text in ("", "Namespace(", "Namespace(a=open('x'))", "__import__('os')", "Other(a=1)", "(" * 5000):
        path.write_text(text)
        with refuses(FileFormatError):
            read_cfg_args(path)


def test_latest_point_cloud(tmp_path):
    with refuses(MissingFileError):
        latest_point_cloud(tmp_path)
    for step in (7000, 30000, 900):
        folder = tmp_path / "point_cloud" / f"iteration_{step}"
        folder.mkdir(parents=True)
        (folder / "point_cloud.ply").write_text("x")
    (tmp_path / "point_cloud" / "iteration_best").mkdir()
    assert latest_point_cloud(tmp_path).parent.name == "iteration_30000"
    assert latest_point_cloud(tmp_path / "point_cloud").parent.name == "iteration_30000"
