"""Readers against real files (see the fixture ``data_folder``)."""

from __future__ import annotations

import sys

import numpy as np
import pytest
import torch

from children import finished
from io_samples import camera_difference, same_gaussians
from scoup.io import (
    PlyTable,
    load_cameras,
    load_gaussians,
    load_image,
    load_regions,
    read_points,
    read_tracks,
    save_gaussians,
)
from scoup.io.cameras.inria import read_cfg_args
from scoup_lab.evaluate.studies.matches import tracked_points

pytestmark = pytest.mark.data


def test_guitar(data_folder):
    gaussians = load_gaussians(data_folder / "guitar" / "guitar.ply")
    assert len(gaussians) == 90_854
    raw = PlyTable.read(data_folder / "guitar" / "guitar.ply").rows["opacity"]
    assert np.isposinf(raw).sum() == 667
    assert bool((gaussians.opacities[torch.from_numpy(np.isposinf(raw))] == 1).all())
    assert gaussians.sh_degree == 0
    # The plain file was made from the compressed one by another program.
    unpacked = load_gaussians(data_folder / "guitar" / "guitar.compressed.ply")
    for name in ("means", "scales", "opacities", "sh", "quats"):
        torch.testing.assert_close(getattr(unpacked, name), getattr(gaussians, name), rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("name", ["guitar/guitar.ply", "inria_ply/point_cloud.ply"])
def test_real_files_survive_writing(data_folder, tmp_path, name):
    gaussians = load_gaussians(data_folder / name)
    save_gaussians(gaussians, tmp_path / "again.ply")
    again = load_gaussians(tmp_path / "again.ply")
    assert same_gaussians(gaussians, again)
    assert gaussians.fingerprint() == again.fingerprint()
    PlyTable.read(data_folder / name).write(tmp_path / "table.ply")
    assert (tmp_path / "table.ply").read_bytes() == (data_folder / name).read_bytes()


def test_kitchen_cameras_agree(data_folder):
    inria = load_cameras(data_folder / "kitchen" / "cameras.json")
    nerfstudio = load_cameras(data_folder / "kitchen" / "transforms.json")
    assert len(inria) == 24
    assert camera_difference(inria, nerfstudio) < 1e-9
    assert load_image(inria[0]).shape == (720, 960, 3)


def test_kitchen_splat(data_folder):
    gaussians = load_gaussians(data_folder / "kitchen" / "scene")
    assert len(gaussians) == 124_495
    # Axes and units fit: most of the splat lies before some camera.
    camera = load_cameras(data_folder / "kitchen")[0]
    depth = gaussians.means.double() @ camera.viewmat[2, :3] + camera.viewmat[2, 3]
    assert (depth > 0).float().mean() > 0.5


def test_desk_cameras_agree(data_folder):
    colmap = load_cameras(data_folder / "desk")
    inria = load_cameras(data_folder / "desk" / "cameras.json")
    assert len(colmap) == 29
    assert camera_difference(colmap, inria) < 1e-9
    assert (colmap[0].width, colmap[0].height) == (953, 535)
    assert len(read_points(data_folder / "desk" / "sparse" / "0")[0]) == 7562
    assert read_cfg_args(data_folder / "desk" / "cfg_args")["sh_degree"] == 3


def test_kitchen_features(data_folder, tmp_path):
    script = data_folder / "kitchen" / "make_langsplat_features.py"
    command = [sys.executable, script, data_folder / "kitchen", "--out", tmp_path]
    finished(command, check=True)
    cameras = load_cameras(data_folder / "kitchen")
    regions = load_regions(tmp_path, cameras)
    assert regions.view_names == cameras.names
    totals = [len(regions.embeddings(level)[0]) for level in regions.levels]
    assert totals == [2204, 1112, 786]
    item = regions.load("frame_00003.jpg", "m")
    source = np.load(data_folder / "kitchen" / "features" / "frame_00003.npz")["m"].astype(np.float32)
    torch.testing.assert_close(item.embeddings, torch.from_numpy(source), atol=2e-3, rtol=0)
    assert item.labels.shape == (720, 960)


def test_desk_tracks(data_folder):
    """Every point was seen in two images or more, and projects into them."""
    folder = data_folder / "desk" / "sparse" / "0"
    positions, tracks = read_tracks(folder)
    assert len(positions) == 7562
    np.testing.assert_array_equal(positions, read_points(folder)[0])
    assert min(len(track) for track in tracks) >= 2
    matches = tracked_points(folder, load_cameras(data_folder / "desk"))
    assert matches is not None
    assert matches.source == "COLMAP tracks"
    seen = sum(len(point) for point in matches.points)
    assert seen > 0.99 * sum(len(set(track)) for track in tracks)
