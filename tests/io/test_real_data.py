"""Readers against real files (see the fixture ``data_folder``)."""

from __future__ import annotations

import runpy
import sys

import numpy as np
import pytest
import torch

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
from scoup.scene import LEVELS, sanity_problems

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
    assert sanity_problems(unpacked) == []


@pytest.mark.parametrize("name", ["guitar/guitar.ply", "inria_ply/point_cloud.ply"])
def test_real_files_survive_writing(data_folder, tmp_path, name):
    gaussians = load_gaussians(data_folder / name)
    assert sanity_problems(gaussians) == []
    save_gaussians(gaussians, tmp_path / "again.ply")
    again = load_gaussians(tmp_path / "again.ply")
    assert same_gaussians(gaussians, again)
    assert gaussians.fingerprint() == again.fingerprint()
    PlyTable.read(data_folder / name).write(tmp_path / "table.ply")
    assert (tmp_path / "table.ply").read_bytes() == (data_folder / name).read_bytes()


def test_kitchen(data_folder):
    """That its axes and units fit the cameras, tests/test_kitchen.py tells by a render."""
    inria = load_cameras(data_folder / "kitchen" / "cameras.json")
    nerfstudio = load_cameras(data_folder / "kitchen" / "transforms.json")
    assert len(inria) == 24
    assert camera_difference(inria, nerfstudio) < 1e-9
    assert load_image(inria[0]).shape == (720, 960, 3)
    gaussians = load_gaussians(data_folder / "kitchen" / "scene")
    assert len(gaussians) == 124_495
    assert sanity_problems(gaussians) == []


def test_kitchen_features(data_folder, tmp_path, monkeypatch):
    """Of four of its views."""
    kitchen, part = data_folder / "kitchen", tmp_path / "part"
    (part / "features").mkdir(parents=True)
    (part / "regions").symlink_to(kitchen / "regions")
    sources = {}
    for path in sorted(kitchen.glob("features/frame_*.npz"))[:4]:
        (part / "features" / path.name).symlink_to(path)
        sources[f"{path.stem}.jpg"] = np.load(path)
    script = kitchen / "make_langsplat_features.py"
    monkeypatch.setattr(sys, "argv", [str(script), str(part), "--out", str(tmp_path / "out")])
    runpy.run_path(str(script))
    regions = load_regions(tmp_path / "out", load_cameras(kitchen).select(list(sources)))
    assert regions.view_names == tuple(sources)
    for name, source in sources.items():
        for level in LEVELS:
            item = regions.load(name, level)
            expected = torch.from_numpy(source[level].astype(np.float32))
            torch.testing.assert_close(item.embeddings, expected, atol=2e-3, rtol=0)
            assert item.labels.shape == (720, 960)


def test_desk(data_folder):
    """Every point was seen in two images or more, and projects into them."""
    desk = data_folder / "desk"
    colmap, inria = load_cameras(desk), load_cameras(desk / "cameras.json")
    assert len(colmap) == 29
    assert camera_difference(colmap, inria) < 1e-9
    assert (colmap[0].width, colmap[0].height) == (953, 535)
    assert read_cfg_args(desk / "cfg_args")["sh_degree"] == 3
    positions, tracks = read_tracks(desk / "sparse" / "0")
    assert len(positions) == 7562
    np.testing.assert_array_equal(positions, read_points(desk / "sparse" / "0")[0])
    assert min(len(track) for track in tracks) >= 2
    seen = 0
    for camera in colmap:
        rows = [row for row, names in enumerate(tracks) if camera.name in names]
        seen += int(camera.shows(torch.from_numpy(positions[rows])).sum())
    assert seen > 0.99 * sum(len(set(track)) for track in tracks)
