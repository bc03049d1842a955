"""Variants of the rules over masks: what becomes of things, by hand, and points answered from memory."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from benchmarks.mask_instances import instances
from benchmarks.mask_rules import Decoded, Rule, by_size, cut, fates

from mask_samples import smooth_image
from scoup.extract.masks import Masks
from scoup.extract.settings import mask_settings
from scoup.models.sam import open_sam
from scoup.scene.regions import LEVELS
from scoup_lab.data.labels import LabelledFrame
from scoup_lab.synthetic.scene import make_demo_scene
from tiny_models import saved, tiny_sam


def test_what_becomes_of_a_thing() -> None:
    thing = np.zeros((10, 10), bool)
    thing[2:6, 2:6] = True
    whole, host, halves, few = (np.full((10, 10), -1, np.int16) for _ in range(4))
    whole[2:6, 2:5] = 0
    host[0:8, 0:8] = 3
    halves[2:6, 2:4], halves[2:6, 4:6], halves[2, 2:4] = 0, 1, 2
    few[2, 2:6] = 0
    frame = LabelledFrame("view", 10, 10, {"cup": torch.from_numpy(thing)}, {})
    maps = {"a": whole, "b": host, "c": halves, "d": few}
    found = fates(maps, frame)["cup"]
    assert {level: fate for level, (_, fate) in found.items()} == {
        "a": "found", "b": "swallowed", "c": "found", "d": "missing",
    }  # fmt: skip
    assert found["a"][0] == 12 / 16
    assert found["b"][0] == 16 / 64
    quarters = np.full((10, 10), -1, np.int16)
    quarters[2:6, 2:6] = np.arange(4).reshape(2, 2).repeat(2, 0).repeat(2, 1)
    assert fates({"s": quarters}, frame)["cup"]["s"] == (0.25, "split")


def test_levels_by_size() -> None:
    dense = np.zeros((4, 100, 100), bool)
    dense[0, :5, :5], dense[1, :6, :5], dense[2, 40:55, 40:55], dense[3, 20:, 20:] = True, True, True, True
    masks = Masks.from_dense(dense)
    found = by_size(
        {"s": masks.select([3, 0]), "m": masks.select([1]), "l": masks.select([2])}, mask_settings("fast")
    )
    assert [found[level].areas().tolist() for level in LEVELS] == [[25], [225], [6400]]


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return saved(tiny_sam(), tmp_path_factory.mktemp("sam"))


def test_points_are_answered_as_by_the_model(tiny: Path) -> None:
    image, sam = smooth_image(40, 60), open_sam(str(tiny))
    decoded = Decoded(sam, image)
    points = torch.tensor(
        [[(5.5) / 32 * 60, 9.5 / 32 * 40], [31.5 / 32 * 60, 0.5 / 32 * 40]], dtype=torch.float64
    )
    wanted = sam.encode(image).predict(points)
    for found, each in zip(decoded.predict(points), wanted, strict=True):
        torch.testing.assert_close(found, each, atol=1e-4, rtol=1e-4)
    loose = replace(mask_settings("fast"), predicted_iou=0.0, stability=0.0, least_score=0.0)
    painted, asked = cut(image, decoded, Rule(replace(loose, skip_covered=False)))
    assert asked == 1024
    assert tuple(painted) == LEVELS
    assert all(set(np.unique(of)) - {-1} == set(range(int(of.max()) + 1)) for of in painted.values())
    assert cut(image, decoded, Rule(loose))[1] < 1024
    assert tuple(cut(image, decoded, Rule(with_default=True))[0]) == (*LEVELS, "default")


def test_things_of_true_regions_fit_what_is_marked() -> None:
    demo = make_demo_scene(0, 6000, 96, 72, 5, 1)
    frames = [(demo.labelled_frame(camera.name, ("m",)), camera) for camera in demo.building]
    frames = [(frame, camera) for frame, camera in frames if frame.masks][:2]
    assert frames
    maps = {}
    for camera in demo.building:
        truth = demo.regions.load(camera.name, "m").labels.numpy().astype(np.int16)
        maps[camera.name] = dict.fromkeys(LEVELS, truth)
    found = instances(demo.gaussians, demo.building, maps, frames)
    assert found["things"] > 3
    pairs = [pair for of in found["ious"].values() for pair in of.values()]
    assert len(pairs) == sum(len(frame.masks) for frame, _ in frames)
    means = np.mean(pairs, 0)
    assert means[1] >= means[0] > 0.3
