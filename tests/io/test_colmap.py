from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
import torch

from io_samples import camera_difference, save_images, some_cameras, write_colmap_text
from scoup.base import FileFormatError, MissingFileError, OutputExistsError
from scoup.io import load_cameras
from scoup.io.cameras.colmap import read_colmap, read_points, write_colmap


@pytest.mark.parametrize("write", [write_colmap, write_colmap_text])
def test_round_trip(tmp_path, write):
    cameras = some_cameras(60)
    points = np.random.default_rng(0).normal(size=(4, 3)), np.arange(12, dtype=np.uint8).reshape(4, 3)
    write(cameras, tmp_path / "sparse" / "0", points)
    assert camera_difference(cameras, read_colmap(tmp_path / "sparse" / "0")) < 1e-12
    positions, colors = read_points(tmp_path / "sparse" / "0")
    assert np.array_equal(positions, points[0])
    assert np.array_equal(colors, points[1])


def test_a_model_is_not_overwritten(tmp_path):
    write_colmap(some_cameras(1), tmp_path)
    with pytest.raises(OutputExistsError):
        write_colmap(some_cameras(1), tmp_path)


@pytest.mark.parametrize("text", [False, True])
def test_pycolmap_reads_what_we_write_and_we_what_it_writes(tmp_path, text):
    pycolmap = pytest.importorskip("pycolmap")
    cameras = some_cameras(4)
    points = np.random.default_rng(0).normal(size=(3, 3)), np.arange(9, dtype=np.uint8).reshape(3, 3)
    (write_colmap_text if text else write_colmap)(cameras, tmp_path / "ours", points)
    model = pycolmap.Reconstruction(str(tmp_path / "ours"))
    assert model.num_images() == 4
    for image in model.images.values():
        camera = cameras[image.name]
        np.testing.assert_allclose(image.cam_from_world().matrix(), camera.viewmat[:3], atol=1e-12)
        np.testing.assert_allclose(model.cameras[image.camera_id].calibration_matrix(), camera.K, atol=1e-12)
    theirs = tmp_path / "theirs"
    theirs.mkdir()
    (model.write_text if text else model.write_binary)(str(theirs))
    assert camera_difference(cameras, read_colmap(theirs)) < 1e-9
    np.testing.assert_allclose(np.sort(read_points(theirs)[0], axis=0), np.sort(points[0], axis=0))


def text_model(folder, camera_line: str, image_lines: str = "1 1 0 0 0 0.5 0.25 2 1 a b.jpg\n\n"):
    folder.mkdir(exist_ok=True)
    (folder / "cameras.txt").write_text(f"# cameras\n{camera_line}\n")
    (folder / "images.txt").write_text(f"# images\n{image_lines}")
    return folder


def test_text_with_empty_keypoint_lines_and_spaces_in_names(tmp_path):
    images = "1 1 0 0 0 0 0 0 1 b c.jpg\n\n2 1 0 0 0 0 0 0 1 a.jpg\n1.5 2.5 -1 3 4 7\n"
    cameras = read_colmap(text_model(tmp_path, "1 SIMPLE_PINHOLE 40 30 50 20 15", images))
    assert cameras.names == ("a.jpg", "b c.jpg")
    assert cameras[0].K.tolist() == [[50, 0, 20], [0, 50, 15], [0, 0, 1]]


@pytest.mark.parametrize(("line", "expected"), [
    ("1 SIMPLE_RADIAL 40 30 50 20 15 0.1", (0.1, 0, 0, 0)),
    ("1 RADIAL 40 30 50 20 15 0.1 -0.02", (0.1, -0.02, 0, 0)),
    ("1 OPENCV 40 30 50 51 20 15 0.1 -0.02 0.001 0.002", (0.1, -0.02, 0.001, 0.002)),
])  # fmt: skip
def test_distortion_is_refused_or_kept(tmp_path, line, expected):
    folder = text_model(tmp_path, line)
    with pytest.raises(FileFormatError, match=r"has lens distortion.*image_undistorter.*undistort"):
        read_colmap(folder)
    assert read_colmap(folder, distorted="undistort")[0].distortion == expected
    parameters = line.split()
    zeros = ["0" if "0." in value else value for value in parameters]
    camera = read_colmap(text_model(tmp_path, " ".join(zeros)))[0]
    assert camera.distortion == ()


@pytest.mark.parametrize(
    "model", ["OPENCV_FISHEYE 40 30 50 50 20 15 0 0 0 0", "FOV 40 30 50 50 20 15 1", "MYOWN 4 3 1"]
)
def test_other_models_are_refused_by_name(tmp_path, model):
    folder = text_model(tmp_path, f"1 {model}")
    with pytest.raises(FileFormatError, match=f"{model.split()[0]} is not supported.*image_undistorter"):
        read_colmap(folder, distorted="undistort")


def test_missing_models(tmp_path):
    for read, path, said in (
        (read_colmap, tmp_path / "none", "no such folder"), (read_colmap, tmp_path, "no COLMAP model"),
        (read_points, tmp_path, "points3D"),
    ):  # fmt: skip
        with pytest.raises(MissingFileError, match=said):
            read(path)


DAMAGES = {
    "images cut": ("images.bin", lambda whole: whole[:-3], r"images.bin: ends in the middle"),
    "images claimed": ("images.bin", lambda whole: struct.pack("<Q", 10**12) + whole[8:], "claims 1000000000000 image"),
    "no images": ("images.bin", lambda _: struct.pack("<Q", 0), "contains no cameras"),
    "no lenses": ("cameras.bin", lambda _: struct.pack("<Q", 0), "refers to camera 1, which cameras.bin does not"),
    "points claimed": ("points3D.bin", lambda whole: whole[:-8] + struct.pack("<Q", 2**61), r"points3D.bin"),
}  # fmt: skip


@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_models(tmp_path, damage):
    file, change, said = DAMAGES[damage]
    write_colmap(some_cameras(2), tmp_path, (np.ones((2, 3)), np.ones((2, 3), np.uint8)))
    (tmp_path / file).write_bytes(change((tmp_path / file).read_bytes()))
    with pytest.raises(FileFormatError, match=said):
        (read_points if file == "points3D.bin" else read_colmap)(tmp_path)


def test_images_without_a_rotation(tmp_path):
    folder = text_model(tmp_path, "1 SIMPLE_PINHOLE 40 30 50 20 15", "1 0 0 0 0 0 0 0 1 a.jpg\n\n")
    with pytest.raises(FileFormatError, match="has no rotation"):
        read_colmap(folder)
    folder = text_model(tmp_path, "1 SIMPLE_PINHOLE 40 30 50 20 15", "1 2 0 0 0 0 0 0 1 a.jpg\n\n")
    assert torch.equal(read_colmap(folder)[0].viewmat, torch.eye(4, dtype=torch.float64))


def test_cameras_of_impossible_sizes_and_lengths(tmp_path: Path) -> None:
    """Focal lengths that vanish when the camera is brought to the size of its image, and more pixels than there are."""
    cameras = some_cameras(1)
    write_colmap_text(cameras, tmp_path / "sparse" / "0")
    save_images(cameras, tmp_path / "images", divisor=2)
    lens = tmp_path / "sparse" / "0" / "cameras.txt"
    for line, said in (
        ("1 PINHOLE 32 24 5e-324 5e-324 16 12", "focal length"),
        ("1 PINHOLE 100000 75000 9 9 16 12", "100000 x 75000 pixels, not an image size"),
    ):
        lens.write_text(line + "\n")
        with pytest.raises(FileFormatError, match=f"sparse/0.*{said}"):
            load_cameras(tmp_path)
