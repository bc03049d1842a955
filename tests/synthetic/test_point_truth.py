"""Synthetic data sets of the point-level protocols and of Ref-LERF: files, and truths against the scene's own."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import torch

from scoup.io import load_gaussians
from scoup.models.word_table import load_table
from scoup_lab.data.class_names import NYU40, SCANNET20, SCANNET200
from scoup_lab.data.labelled_points import read_labelled_ply
from scoup_lab.evaluate.protocols import ref_lerf
from scoup_lab.synthetic import DemoScene, make_demo_scene
from scoup_lab.synthetic.point_truth import NYU40_OF, SCAN_NOISE, SCANNET200_OF, classes_of_gaussians
from scoup_lab.synthetic.referring import nearest_objects, side_of


def demo() -> DemoScene:
    """The scene behind the shared data sets."""
    return make_demo_scene(0, 4000, 96, 72, 6, 0)


def of_object(scene: DemoScene, name: str) -> torch.Tensor:
    """[N] boolean: the Gaussians of an object."""
    objects = scene.parts.at_level(scene.part_of_gaussian.numpy(), "m")
    return torch.from_numpy(objects == scene.parts.objects.index(name))


def test_things_have_classes_that_there_are() -> None:
    assert set(NYU40_OF.values()) <= set(NYU40)
    assert set(SCANNET200_OF.values()) <= set(SCANNET200)
    assert set(SCANNET200_OF.values()) & set(SCANNET20) >= {"wall", "floor", "chair", "table", "bookshelf"}


def test_scannet(synthetic_data_sets: Path) -> None:
    folder = synthetic_data_sets / "scannet" / "table"
    points = read_labelled_ply(folder / "table_vh_clean_2.labels.ply")
    splat, scene = load_gaussians(folder / "point_cloud.ply"), demo()
    assert points.positions.equal(splat.means)
    for thing, number in {"wall": 1, "chair": 5, "shelf": 10, "red book": 23, "kettle": 40}.items():
        assert (points.labels[of_object(scene, thing)] == number).all()
    assert (points.labels[scene.part_of_gaussian < 0] == 0).all()
    table = load_table(folder / "text.npz")
    assert set(NYU40) <= set(table.names)
    vector = dict(zip(table.names, table.vectors, strict=True))
    assert np.allclose(vector["bookshelf"], vector["shelf"])
    # Classes that the scene lacks are words like any other: neither alike nor opposite.
    cosine = float(vector["toilet"] @ vector["bed"])
    assert 0.4 < cosine < 0.75


def test_scenesplat(synthetic_data_sets: Path) -> None:
    folder = synthetic_data_sets / "scenesplat" / "val" / "table"
    scene = demo()
    assert not (folder / "point_cloud.ply").exists()
    assert len(load_gaussians(folder)) == 4000
    scanned = (scene.part_of_gaussian >= 0).numpy()
    for stem, classes in (("segment20", SCANNET20), ("segment200", SCANNET200)):
        numbers = np.load(folder / f"{stem}.npy")
        truth = classes_of_gaussians(scene, classes, SCANNET200_OF)
        assert numbers.dtype == np.int16
        assert np.array_equal(numbers, truth.numpy())
        assert np.array_equal(np.load(folder / f"pc_{stem}.npy"), numbers[scanned])
        assert (numbers[of_object(scene, "chair").numpy()] == classes.index("chair")).all()
    laptop = of_object(scene, "laptop").numpy()
    assert (np.load(folder / "segment20.npy")[laptop] == -1).all()
    assert (np.load(folder / "segment200.npy")[laptop] == SCANNET200.index("laptop")).all()
    apart = np.load(folder / "pc_coord.npy") - np.load(folder / "coord.npy")[scanned]
    assert 0.5 * SCAN_NOISE < apart.std() < 2 * SCAN_NOISE
    names = load_table(folder / "text.npz").names
    assert {f"this is a {name}" for name in (*SCANNET20, *SCANNET200)} <= set(names)


def test_ref_lerf(synthetic_data_sets: Path) -> None:
    folder, scene = synthetic_data_sets / "ref-lerf" / "table", demo()
    assert len(list((folder / "json" / "test_json").iterdir())) == 2
    assert len(list((folder / "json" / "train_json").iterdir())) == 4
    frames = ref_lerf.read_frames(folder)
    assert [frame.name for frame in frames] == ["frame_00001", "frame_00007"]
    truth = scene.labelled_frame(scene.building[0].name, ("m",))
    assert len(frames[0].labels) > 2 * len(truth.labels)
    names = load_table(folder / "text.npz").names
    for name in truth.labels:
        assert frames[0].masks[f"the {name}"].equal(truth.masks[name])
    assert set(frames[0].labels) <= set(names)
    content = json.loads((folder / "json" / "test_json" / "frame_00001.json").read_text())
    assert set(content) == {"object"}
    assert all(set(item) == {"category", "segmentation", "sentence"} for item in content["object"])


def test_sides_are_those_of_the_frame(synthetic_data_sets: Path) -> None:
    sided = 0
    for frame in ref_lerf.read_frames(synthetic_data_sets / "ref-lerf" / "table"):
        for sentence in frame.labels:
            for side, sign in (("left", 1), ("right", -1)):
                name, found, other = sentence.partition(f" {side} of ")
                if found:
                    middles = [frame.masks[each].nonzero()[:, 1].double().mean() for each in (name, other)]
                    assert sign * (middles[1] - middles[0]) > 0
                    sided += 1
    assert sided > 5
    one = torch.zeros(2, 9, dtype=torch.bool)
    one[:, 3:6] = True
    assert side_of(one.roll(-3, 1), one) == "left"
    assert side_of(one.roll(3, 1), one) == "right"
    assert side_of(one.roll(2, 1), one) is None
    assert side_of(one, None) is None


def test_the_nearest_other_object() -> None:
    beside = nearest_objects(demo())
    assert beside["cushion"] == "chair"
    assert all(name != other for name, other in beside.items())
    assert beside["donut"] == "plate"
