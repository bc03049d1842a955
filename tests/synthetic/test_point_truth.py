"""Synthetic data sets in the layout of ScanNet: files, and truths against the scene's own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from scoup.io import load_gaussians
from scoup.models import WordTable
from scoup_lab.data.labelled_points import NYU40, read_labelled_ply
from scoup_lab.synthetic import DemoScene, make_demo_scene
from scoup_lab.synthetic.point_truth import NYU40_OF


def demo() -> DemoScene:
    """The scene behind the shared data sets."""
    return make_demo_scene(0, 4000, 96, 72, 6, 0)


def of_object(scene: DemoScene, name: str) -> torch.Tensor:
    """[N] boolean: the Gaussians of an object."""
    objects = scene.parts.at_level(scene.part_of_gaussian.numpy(), "m")
    return torch.from_numpy(objects == scene.parts.objects.index(name))


def test_things_have_classes_that_there_are() -> None:
    assert set(NYU40_OF.values()) <= set(NYU40)


def test_scannet(synthetic_data_sets: Path) -> None:
    folder = synthetic_data_sets / "scannet" / "table"
    points = read_labelled_ply(folder / "table_vh_clean_2.labels.ply")
    splat, scene = load_gaussians(folder / "point_cloud.ply"), demo()
    assert points.positions.equal(splat.means)
    for thing, number in {"wall": 1, "chair": 5, "shelf": 10, "red book": 23, "kettle": 40}.items():
        assert (points.labels[of_object(scene, thing)] == number).all()
    assert (points.labels[scene.part_of_gaussian < 0] == 0).all()
    table = WordTable.load(folder / "text.npz")
    assert set(NYU40) <= set(table.names)
    vector = dict(zip(table.names, table.vectors, strict=True))
    assert np.allclose(vector["bookshelf"], vector["shelf"])
    # Classes that the scene lacks are words like any other: neither alike nor opposite.
    cosine = float(vector["toilet"] @ vector["bed"])
    assert 0.4 < cosine < 0.75
