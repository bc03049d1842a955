"""SceneSplat-Bench: classes, files, the class of the nearest Gaussians."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from scoup.base.errors import FileFormatError, InputError, MissingFileError
from scoup_lab.evaluate.protocols import scenesplat
from scoup_lab.evaluate.protocols.points import NO_CLASS, nearest_classes

CLASSES = scenesplat.CLASS_LISTS


def test_classes_are_those_of_the_published_lists() -> None:
    sizes = {name: len(classes.classes) for name, classes in CLASSES.items()}
    assert sizes == {"scannet20": 20, "scannet200": 200, "scannetpp": 100, "matterport": 21, "holicity": 4}
    assert CLASSES["scannet20"].classes[:3] == ("wall", "floor", "cabinet")
    assert CLASSES["scannet20"].classes[15] == "shower curtain"
    assert CLASSES["scannet20"].classes[19] == "other furniture"
    assert CLASSES["matterport"].classes[20] == "ceiling"
    # Every fortieth of the longer lists: one name left out or put in would move the rest.
    assert CLASSES["scannet200"].classes[::40] == ("wall", "bag", "radiator", "mini fridge", "vent")
    assert CLASSES["scannet200"].classes[-1] == "mattress"
    assert CLASSES["scannetpp"].classes[::20] == ("wall", "pipe", "pillow", "shoe rack", "paper bag")
    assert CLASSES["scannetpp"].classes[-1] == "marker"
    for classes in CLASSES.values():
        assert len(set(classes.classes)) == len(classes.classes)


def test_foreground_leaves_out_walls_floors_and_ceilings() -> None:
    assert int((~CLASSES["scannet20"].foreground).sum()) == 2
    assert int((~CLASSES["scannet200"].foreground).sum()) == 3
    assert int((~CLASSES["matterport"].foreground).sum()) == 4
    assert CLASSES["holicity"].foreground.all()


def test_texts() -> None:
    assert CLASSES["scannet20"].texts[4] == "this is a chair"
    texts = CLASSES["holicity"].texts
    assert len(texts) == 6
    cars, walkers = texts.index("this is a car or vehicle"), texts.index("this is a pedestrian")
    found = CLASSES["holicity"].of_texts(torch.tensor([cars, walkers]))
    assert [CLASSES["holicity"].classes[number] for number in found] == ["roads", "terrains"]


MEANS = torch.tensor([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]])


def test_points_take_the_class_of_the_nearest_gaussian_that_has_one() -> None:
    points = torch.tensor([[0.4, 0, 0], [1.1, 0, 0], [9, 9, 9]])
    classes = torch.tensor([2, NO_CLASS, 1, 0])
    assert nearest_classes(MEANS, classes, points, 3).tolist() == [2, 1, 0]
    lost = MEANS.index_fill(0, torch.tensor([2]), torch.nan)
    assert nearest_classes(lost, classes, points, 3).tolist() == [2, 2, 0]


def test_several_gaussians_vote_and_the_smallest_number_wins_a_draw() -> None:
    points = torch.tensor([[1.9, 0, 0]])
    classes = torch.tensor([0, 1, 2, 1])
    assert nearest_classes(MEANS, classes, points, 3, neighbours=1).tolist() == [2]
    assert nearest_classes(MEANS, classes, points, 3, neighbours=2).tolist() == [1]
    assert nearest_classes(MEANS, classes, points, 3, neighbours=3).tolist() == [1]
    assert nearest_classes(MEANS, classes, points, 3, neighbours=25).tolist() == [1]


def test_nobody_to_vote() -> None:
    with pytest.raises(InputError, match="0 Gaussians have a class"):
        nearest_classes(MEANS, torch.full((4,), NO_CLASS), MEANS, 3)


def write_points(folder: Path, prefix: str = "", count: int = 4, **labels: np.ndarray) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    np.save(folder / f"{prefix}coord.npy", np.arange(3.0 * count, dtype=np.float32).reshape(count, 3))
    for name, numbers in labels.items():
        np.save(folder / f"{prefix}{name}.npy", numbers)
    return folder


def test_the_points_of_the_scan_come_first(tmp_path: Path) -> None:
    write_points(tmp_path, segment20=np.array([0, 1, -1, 19], np.int16))
    found = scenesplat.read_truth(tmp_path, CLASSES["scannet20"])
    assert found.labels.tolist() == [0, 1, -1, 19]
    assert found.positions[1].tolist() == [3, 4, 5]
    write_points(tmp_path, "pc_", count=2, segment20=np.array([5, -100]))
    assert scenesplat.read_truth(tmp_path, CLASSES["scannet20"]).labels.tolist() == [5, NO_CLASS]


def test_the_first_of_several_classes_counts(tmp_path: Path) -> None:
    numbers = np.array([[7, 3, -1], [-1, -1, -1], [99, 0, 0], [2, -1, -1]], np.int32)
    write_points(tmp_path, segment=numbers)
    assert scenesplat.read_truth(tmp_path, CLASSES["scannetpp"]).labels.tolist() == [7, -1, 99, 2]


def test_other_benchmarks_are_told_apart(tmp_path: Path) -> None:
    write_points(tmp_path, segment=np.array([0, 1, 2, 99]))
    with pytest.raises(
        MissingFileError, match=r"segment20.npy: .*pass the classes of the benchmark \(scannet20"
    ):
        scenesplat.read_truth(tmp_path, CLASSES["scannet20"])
    with pytest.raises(FileFormatError, match="has a class 99, matterport has 21"):
        scenesplat.read_truth(tmp_path, CLASSES["matterport"])


def test_scenes_lie_in_splits(tmp_path: Path) -> None:
    for place in ("val/b", "test/a", "val/c", "d"):
        write_points(tmp_path / place)
    assert scenesplat.scene_names(tmp_path) == ["a", "b", "c", "d"]
    assert scenesplat.scene_folder(tmp_path, "a") == tmp_path / "test" / "a"
    assert scenesplat.scene_folder(tmp_path, "d") == tmp_path / "d"
    assert scenesplat.scene_folder(tmp_path, "e") == tmp_path / "val" / "e"
