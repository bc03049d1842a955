"""Synthetic data sets: every file of each layout is there, read by the readers of real ones, and true."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from benchmarks.scenes import find_layout
from PIL import Image

from messages import refuses
from scoup.base import OutputExistsError, UnknownNameError
from scoup.io import load_cameras, load_gaussians, load_regions, read_points
from scoup.models import WordTable
from scoup_lab.data.labelled_points import NYU40, read_labelled_ply
from scoup_lab.data.labels import read_labels
from scoup_lab.evaluate.protocols import PIXELS, threed_ovs
from scoup_lab.evaluate.scenes import Places
from scoup_lab.synthetic import TABLE, DemoScene, make_demo_scene
from scoup_lab.synthetic.data_sets import DataSetSize, write_data_set
from scoup_lab.synthetic.point_truth import NYU40_OF


@pytest.fixture(scope="module")
def demo() -> DemoScene:
    """The scene behind the shared data sets."""
    return make_demo_scene(0, 4000, 96, 72, 6, 0)


@pytest.mark.parametrize("name", ["lerf-ovs", "3d-ovs", "mipnerf360"])
def test_synthetic_data_sets_are_complete(synthetic_data_sets: Path, name: str) -> None:
    root = synthetic_data_sets / name
    protocol = PIXELS[name]
    assert protocol.find(root) == ["shelves", "table"]
    scene = protocol.open(root, "table")
    assert len(load_gaussians(scene.splat)) == 4000
    assert len(scene.cameras) == 6
    regions = load_regions(scene.features, scene.cameras)
    assert len(regions) == 6
    assert len(read_points(root / "table" / "sparse" / "0")[0]) == 4000
    assert len(scene.frames) == 2
    table = WordTable.load(root / "table" / "text.npz")
    assert {*scene.labels, "object", "things", "stuff", "texture"} <= set(table.names)
    for camera in scene.cameras:
        assert camera.image_path is not None
        with Image.open(camera.image_path) as image:
            assert image.size == (96, 72)
    assert name in (root / "README.txt").read_text()


def test_image_names_are_those_of_the_data_sets_and_no_positions(synthetic_data_sets: Path) -> None:
    for name, first in (
        ("lerf-ovs", ("frame_00001.png", "frame_00003.png", "frame_00004.png")),
        ("3d-ovs", ("00.png", "02.png", "03.png")),
    ):
        assert load_cameras(synthetic_data_sets / name / "table").names[:3] == first
    assert load_cameras(synthetic_data_sets / "mipnerf360" / "table").names[0].startswith("DSCF")


def test_labels_are_the_truth_of_the_scene(synthetic_data_sets: Path, demo: DemoScene) -> None:
    smaller = read_labels(synthetic_data_sets / "mipnerf360" / "label" / "table")[0]
    assert (smaller.width, smaller.height) == (48, 36)  # which may have their own size
    frames = read_labels(synthetic_data_sets / "lerf-ovs" / "label" / "table")
    truth = demo.labelled_frame(demo.building[0].name, ("m", "l"))
    assert frames[0].labels == truth.labels
    for label, mask in truth.masks.items():
        assert torch.equal(frames[0].masks[label], mask)
    painted = threed_ovs.read_segmentations(synthetic_data_sets / "3d-ovs" / "table")
    assert len(painted) == 2
    for label, mask in painted[0].masks.items():
        assert torch.equal(mask, truth.masks[label])
    # Regions follow their views when these are renamed.
    cameras = load_cameras(synthetic_data_sets / "lerf-ovs" / "table")
    regions = load_regions(synthetic_data_sets / "lerf-ovs" / "table" / "language_features", cameras)
    for new, old in zip(cameras, demo.building, strict=True):
        assert torch.allclose(new.viewmat, old.viewmat, atol=1e-6)
        assert torch.equal(regions.load(new.name, "m").labels, demo.regions.load(old.name, "m").labels)


def test_a_scene_for_each_seed(tmp_path: Path) -> None:
    size = DataSetSize(n_gaussians=2000, width=48, height=36, n_views=2, n_labelled=1)
    names = write_data_set("lerf-ovs", tmp_path, size=size, seeds=(4, 5))
    assert names == ("table_4", "table_5")
    assert PIXELS["lerf-ovs"].find(tmp_path) == list(names)
    first, second = (load_gaussians(tmp_path / name / "point_cloud.ply") for name in names)
    assert first.fingerprint() != second.fingerprint()


def test_refusals(tmp_path: Path) -> None:
    wrong: tuple[dict[str, Any], ...] = (
        {"size": DataSetSize(n_views=3, n_labelled=4)}, {"seeds": ()}, {"layouts": (TABLE, TABLE)},
    )  # fmt: skip
    for given in wrong:
        with refuses():
            write_data_set("lerf-ovs", tmp_path, **given)
    for misspelt in (lambda: write_data_set("scanet", tmp_path), lambda: find_layout("tabel")):
        with refuses(UnknownNameError):
            misspelt()
    (tmp_path / "table").mkdir()
    with pytest.raises(OutputExistsError):
        write_data_set("lerf-ovs", tmp_path)
    assert not list((tmp_path / "table").iterdir())


def test_parts_of_a_scene_may_lie_elsewhere(synthetic_data_sets: Path, tmp_path: Path) -> None:
    protocol, root = PIXELS["lerf-ovs"], synthetic_data_sets / "lerf-ovs"
    places = Places(str(root / "{scene}" / "point_cloud.ply"), str(root / "{scene}" / "language_features"))
    assert protocol.open(root, "table", places).splat == root / "table" / "point_cloud.ply"
    for absent in (Places(gaussians=str(tmp_path / "{scene}.ply")), Places(features="absent")):
        with refuses():
            protocol.open(root, "table", absent)
    for folder in (tmp_path, tmp_path / "absent"):
        with refuses():
            protocol.find(folder)
    with refuses(UnknownNameError):
        protocol.find(root, ["tabel"])


def test_scannet(synthetic_data_sets: Path, demo: DemoScene) -> None:
    assert set(NYU40_OF.values()) <= set(NYU40)
    folder = synthetic_data_sets / "scannet" / "table"
    points = read_labelled_ply(folder / "table_vh_clean_2.labels.ply")
    assert points.positions.equal(load_gaussians(folder / "point_cloud.ply").means)
    objects = demo.parts.at_level(demo.part_of_gaussian.numpy(), "m")
    for thing, number in {"wall": 1, "chair": 5, "shelf": 10, "red book": 23, "kettle": 40}.items():
        assert (points.labels[objects == demo.parts.objects.index(thing)] == number).all()
    assert (points.labels[demo.part_of_gaussian < 0] == 0).all()
    table = WordTable.load(folder / "text.npz")
    assert set(NYU40) <= set(table.names)
    vector = dict(zip(table.names, table.vectors, strict=True))
    assert np.allclose(vector["bookshelf"], vector["shelf"])
    # Classes that the scene lacks are words like any other: neither alike nor opposite.
    cosine = float(vector["toilet"] @ vector["bed"])
    assert 0.4 < cosine < 0.75
