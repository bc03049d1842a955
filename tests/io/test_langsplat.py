from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from io_samples import planes_of, save_npy, some_cameras, unit_rows
from messages import refuses, warns
from scoup.base import FileFormatError, MissingFileError, ScoupWarning, UnknownNameError
from scoup.io import load_regions
from scoup.io.cameras.undistort import photograph_pixels, sample_nearest
from scoup.io.regions.langsplat_rows import level_blocks
from scoup.scene import LEVELS, Cameras


def test_what_langsplat_writes(tmp_path):
    """Values are global row numbers; each level is offset by the sizes of those before."""
    rows = unit_rows(9)
    save_npy(tmp_path, "view_00", planes_of([-1, 0, 1], [2, 3, 4], [-1, 5, 6], [7, 8]), rows)
    regions = load_regions(tmp_path, some_cameras(1))
    for level, start, end in (("s", 2, 5), ("m", 5, 7), ("l", 7, 9)):
        item = regions.load("view_00.png", level)
        np.testing.assert_allclose(item.embeddings, rows[start:end], atol=1e-7)
        assert item.labels.max() == end - start - 1
    assert regions.load("view_00.png", "m").labels.unique().tolist() == [-1, 0, 1]


def test_rows_without_pixels_belong_to_the_level_before():
    path = Path("a_s.npy")
    blocks = level_blocks(path, planes_of([0, 1], [3], [6], [8]), 12)
    assert [(b.start, b.stop) for b in blocks.values()] == [(0, 3), (3, 6), (6, 8), (8, 12)]
    blocks = level_blocks(path, planes_of([-1], [0, 1], [-1], [3, 4]), 5)
    assert [(b.start, b.stop) for b in blocks.values()] == [(0, 0), (0, 3), (3, 3), (3, 5)]
    blocks = level_blocks(path, planes_of([-1], [-1], [-1], [-1]), 5)
    assert sum(b.stop - b.start for b in blocks.values()) == 5
    blocks = level_blocks(path, planes_of([-1], [2], [3], [-1]), 6)
    assert [(b.start, b.stop) for b in blocks.values()] == [(0, 2), (2, 3), (3, 6), (6, 6)]


def test_embeddings_that_are_objects(tmp_path):
    save_npy(tmp_path, "view_00", planes_of([0], [1], [2], [3]), np.array([{"a": 1}] * 4))
    with pytest.raises(FileFormatError, match="plain numbers"):
        load_regions(tmp_path, some_cameras(1))


def test_embeddings_are_scaled_to_unit_norm_and_zero_rows_stay(tmp_path):
    rows = unit_rows(4) * np.array([[1], [3], [0], [1e30]], dtype=np.float32)
    save_npy(tmp_path, "view_00", planes_of([0], [1, 2], [3], [-1]), rows)
    regions = load_regions(tmp_path, some_cameras(1))
    for level, norms in (("s", [1.0, 0.0]), ("m", [1.0])):
        found = regions.load_embeddings("view_00.png", level).norm(dim=1)
        torch.testing.assert_close(found, torch.tensor(norms))


@pytest.mark.parametrize("dtype", ["<f4", "<f2", "<f8", ">f4", "<i4", "i1", "<i8"])
def test_column_major_files_of_every_type(tmp_path, dtype):
    planes = np.random.default_rng(0).integers(-1, 3, (4, 24, 32)).astype(np.float32)
    planes[0] = -1
    planes[2:][planes[2:] >= 0] += 3
    planes[3][planes[3] >= 0] += 3
    save_npy(tmp_path, "view_00", np.asfortranarray(planes.astype(dtype)), unit_rows(9).astype(np.float16))
    labels = load_regions(tmp_path, some_cameras(1)).load("view_00.png", "s").labels
    assert np.array_equal(labels, planes[1])


@pytest.mark.parametrize("dtype", ["<f4", "<f2", ">i2", "<i8", "i1"])
@pytest.mark.parametrize("distortion", [(), (0.1, -0.05)])
def test_labels_of_all_levels_are_those_of_each(tmp_path, dtype, distortion):
    planes = planes_of([-1, 0], [1, -1, 2, 3], [-1], [5, 7, -1])
    save_npy(tmp_path, "view_00", planes.astype(dtype), unit_rows(9))
    camera = replace(some_cameras(1)[0], distortion=distortion)
    regions = load_regions(tmp_path, [camera])
    for width, height in ((camera.width, camera.height), (13, 7)):
        labels = regions.load_labels("view_00.png", width, height)
        maps = [regions.load("view_00.png", level).resized(width, height) for level in LEVELS]
        assert labels.dtype == torch.int32
        assert torch.equal(labels, torch.stack([item.labels for item in maps]))
        again, embeddings = regions.select(["view_00.png"]).load_view("view_00.png", width, height)
        assert torch.equal(again, labels)
        for item, rows in zip(maps, embeddings, strict=True):
            assert torch.equal(item.embeddings, rows)


def test_labels_alone_do_not_read_embeddings(tmp_path):
    save_npy(tmp_path, "view_00", planes_of([0], [1, 2], [3], [-1, 4]), unit_rows(5))
    regions = load_regions(tmp_path, some_cameras(1))
    regions.embeddings("s")
    (tmp_path / "view_00_f.npy").unlink()
    assert regions.load_labels("view_00.png", 32, 24).amax((1, 2)).tolist() == [1, 0, 0]
    with pytest.raises(UnknownNameError):
        regions.load_labels("view_01.png", 32, 24)


def test_files_that_change_while_they_are_open(tmp_path):
    planes = planes_of([0], [1, 2], [3], [-1, 4])
    save_npy(tmp_path, "view_00", planes, unit_rows(5))
    regions = load_regions(tmp_path, some_cameras(1))
    regions.embeddings("s")
    for value in (0, 3, 1e9, -2, np.nan):
        planes[1, 5, 5] = value
        save_npy(tmp_path, "view_00", planes, unit_rows(5))
        with refuses(FileFormatError):
            regions.load_labels("view_00.png", 32, 24)
    save_npy(tmp_path, "view_00", planes, unit_rows(3))
    with refuses(FileFormatError):
        regions.load_embeddings("view_00.png", "m")


def test_labels_follow_the_size_of_the_camera(tmp_path):
    labels = np.arange(12).reshape(3, 4).astype(np.float32)
    planes = np.stack([np.full((3, 4), -1, np.float32), labels, labels + 12, labels + 24])
    save_npy(tmp_path, "view_00", planes, unit_rows(36))
    camera = some_cameras(1, width=8, height=6)[0]
    large = load_regions(tmp_path, [camera]).load("view_00.png", "m").labels
    assert np.array_equal(large, labels.repeat(2, 0).repeat(2, 1))
    for width, height in ((3, 2), (1, 1)):  # of 4 x 3, less a part of a pixel
        tiny = load_regions(tmp_path, some_cameras(1, width, height)).load("view_00.png", "m").labels
        assert tiny.shape == (height, width)
    camera = replace(camera, distortion=(0.3, 0.0, 0.0, 0.0))
    bent = load_regions(tmp_path, [camera]).load("view_00.png", "m").labels
    expected = sample_nearest(torch.from_numpy(labels).int(), photograph_pixels(camera, 4, 3), -1)
    assert torch.equal(bent, expected)
    assert bent.shape == (6, 8)


def test_stems_are_cut_at_the_first_dot(tmp_path):
    camera = replace(some_cameras(1)[0], name="left/img.0001.tar.png")
    save_npy(tmp_path, "img", planes_of([-1], [0], [1], [2]), unit_rows(3))
    assert load_regions(tmp_path, [camera]).view_names == ("left/img.0001.tar.png",)
    other = replace(camera, name="img.0002.png")
    with refuses():
        load_regions(tmp_path, Cameras([camera, other]))


def test_missing_features(tmp_path):
    cameras = some_cameras(4)
    with refuses(MissingFileError):
        load_regions(tmp_path, cameras)
    save_npy(tmp_path, "frame_00001", planes_of([-1], [0], [1], [2]), unit_rows(3))
    with refuses(MissingFileError):
        load_regions(tmp_path, cameras)
    save_npy(tmp_path, "view_02", planes_of([-1], [0], [1], [2]), unit_rows(3))
    with warns(ScoupWarning):
        assert load_regions(tmp_path, cameras).view_names == ("view_02.png",)
    with refuses():
        load_regions(tmp_path, [])


def test_features_of_two_models(tmp_path):
    save_npy(tmp_path, "view_00", planes_of([-1], [0], [1], [2]), unit_rows(3, 4))
    save_npy(tmp_path, "view_01", planes_of([-1], [0], [1], [2]), unit_rows(3, 5))
    with refuses(FileFormatError):
        load_regions(tmp_path, some_cameras(2))
