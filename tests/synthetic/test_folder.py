"""The scene as a folder: everything comes back as it went in."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image, ImageDraw

from scoup.base import OutputExistsError
from scoup.io import load_cameras, load_gaussians, load_regions
from scoup.models import WordTable
from scoup.scene import LEVELS
from scoup_lab.data.labels import match_frames, read_labels
from scoup_lab.synthetic import DemoScene, write_demo_scene
from scoup_lab.synthetic.masks import mask_polygons


@pytest.fixture(scope="module")
def folder(scene: DemoScene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("demo") / "scene"
    return write_demo_scene(scene, path)


def test_gaussians_cameras_regions_and_words_come_back(scene: DemoScene, folder: Path):
    gaussians = load_gaussians(folder)
    assert torch.allclose(gaussians.means, scene.gaussians.means)
    assert torch.allclose(gaussians.scales, scene.gaussians.scales, rtol=1e-5)
    cameras = load_cameras(folder)
    assert cameras.names == scene.building.names
    for camera in cameras:
        assert torch.allclose(camera.viewmat, scene.building[camera.name].viewmat, atol=1e-9)
        assert torch.allclose(camera.K, scene.building[camera.name].K)
    regions = load_regions(folder, cameras)
    for level in LEVELS:
        there, here = regions.load(cameras[0].name, level), scene.regions.load(cameras[0].name, level)
        assert torch.equal(there.labels, here.labels)
        assert torch.allclose(there.embeddings, here.embeddings, atol=1e-6)
    table = WordTable.load(folder / "text.npz")
    assert table.names == scene.words.texts
    assert np.abs(table.vectors - scene.words.vectors).max() < 1e-6


def test_labels_of_held_out_views_are_the_truth(scene: DemoScene, folder: Path):
    cameras = load_cameras(folder / "held_out")
    assert cameras.names == scene.held_out.names
    matched = match_frames(read_labels(folder / "held_out" / "label"), cameras)
    assert len(matched) == len(scene.held_out)
    for frame, camera in matched:
        truth = scene.labelled_frame(camera.name, ("m", "l"))
        assert set(frame.labels) == set(truth.labels)
        for label, mask in truth.masks.items():
            assert torch.equal(frame.masks[label], mask), label


def test_nothing_is_overwritten_unasked(scene: DemoScene, folder: Path):
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*") if path.is_file()}
    with pytest.raises(OutputExistsError):
        write_demo_scene(scene, folder)
    assert {path: path.stat().st_mtime_ns for path in folder.rglob("*") if path.is_file()} == before


def painted(mask: np.ndarray) -> np.ndarray:
    canvas = Image.new("1", mask.shape[::-1])
    for corners, _ in mask_polygons(mask):
        filled = corners + corners[-1:] * (3 - len(corners))
        ImageDraw.Draw(canvas).polygon(filled, fill=1, outline=1)
    return np.array(canvas, bool)


@pytest.mark.parametrize("seed", range(12))
def test_polygons_paint_the_mask_they_came_from(seed: int):
    rng = np.random.default_rng(seed)
    blobs = rng.random((13, 17)) < rng.uniform(0.2, 0.9)
    assert (painted(blobs) == blobs).all()
    large = np.kron(blobs, np.ones((3, 2), bool))
    assert (painted(large) == large).all()


def test_polygon_boxes_surround_the_whole_piece():
    ring = np.zeros((20, 30), bool)
    ring[2:18, 3:27] = True
    ring[6:12, 8:20] = False
    polygons = mask_polygons(ring)
    assert len(polygons) > 1
    assert {box for _, box in polygons} == {(3, 2, 26, 17)}
    assert (painted(ring) == ring).all()
