from __future__ import annotations

import numpy as np
import pytest
import torch

from io_samples import camera_difference, some_cameras, text_model, write_colmap_text
from messages import refuses
from scoup.base.errors import FileFormatError, MissingFileError, OutputExistsError
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
    with refuses(FileFormatError):
        read_colmap(folder)
    assert read_colmap(folder, distorted="undistort")[0].distortion == expected
    parameters = line.split()
    zeros = ["0" if "0." in value else value for value in parameters]
    camera = read_colmap(text_model(tmp_path, " ".join(zeros)))[0]
    assert camera.distortion == ()


def test_missing_models(tmp_path):
    for read, path in ((read_colmap, tmp_path / "none"), (read_colmap, tmp_path), (read_points, tmp_path)):
        with refuses(MissingFileError):
            read(path)


def test_images_without_a_rotation(tmp_path):
    folder = text_model(tmp_path, "1 SIMPLE_PINHOLE 40 30 50 20 15", "1 0 0 0 0 0 0 0 1 a.jpg\n\n")
    with refuses(FileFormatError):
        read_colmap(folder)
    folder = text_model(tmp_path, "1 SIMPLE_PINHOLE 40 30 50 20 15", "1 2 0 0 0 0 0 0 1 a.jpg\n\n")
    assert torch.equal(read_colmap(folder)[0].viewmat, torch.eye(4, dtype=torch.float64))
