"""Variants of the rules over masks: what becomes of things, by hand, and points answered from memory."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from benchmarks.decoded import Decoded
from benchmarks.mask_instances import instances
from benchmarks.mask_rules import cut, fates, read_cut, write_cut
from benchmarks.mask_variants import Rule, best_of_point, by_size, smallest_first

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


def test_each_point_of_a_photograph_is_decoded_once(tiny: Path) -> None:
    image, sam = smooth_image(40, 60), open_sam(str(tiny))
    decoded = Decoded(sam, image)
    points = torch.tensor([[10.3, 11.9], [59.1, 0.6], [10.3, 11.9]], dtype=torch.float64)
    wanted = sam.encode(image).predict(points)
    for chosen in ([0], [0, 1, 2]):
        for found, each in zip(decoded.encode(image).predict(points[chosen]), wanted, strict=True):
            torch.testing.assert_close(found, each[chosen], atol=1e-4, rtol=1e-4)
    assert (decoded.asked, decoded.model.points) == (4, 2)
    assert (decoded.encoded, decoded.images_encoded) == (2, 1)
    decoded.encode(image[:30])
    decoded.encode(image[:30])
    assert decoded.images_encoded == 3


def test_masks_of_a_point_are_changed(tiny: Path) -> None:
    decoded = Decoded(open_sam(str(tiny)), image := smooth_image(40, 60))
    points = torch.rand(8, 2, dtype=torch.float64) * 40
    logits, iou = decoded.encode(image).predict(points)
    decoded.changed = best_of_point
    assert torch.equal(decoded.encode(image).predict(points)[1], iou.amax(1, keepdim=True).expand(8, 3))
    decoded.changed = smallest_first
    areas = (logits > 0).sum((2, 3))
    for point, (mask, score) in enumerate(zip(*decoded.encode(image).predict(points), strict=True)):
        order = sorted(range(3), key=lambda channel: int(areas[point, channel]))
        assert torch.equal(mask, logits[point, order])
        assert torch.equal(score, iou[point, order])


def test_costs_are_those_of_a_run_that_knows_nothing(tiny: Path) -> None:
    image = smooth_image(40, 60)
    decoded = Decoded(open_sam(str(tiny)), image)
    points = torch.rand(64, 2, dtype=torch.float64) * 40
    first, second = (decoded.costs(lambda: decoded.encode(image).predict(points)) for _ in range(2))
    assert first[1] == second[1] == 64
    assert torch.equal(first[0][0], second[0][0])
    of_model = sum(decoded.model.seconds.values())
    assert first[2] >= of_model > 0
    assert second[2] >= of_model  # though nothing was run


def test_rules_ask_their_own_points(tiny: Path, tmp_path: Path) -> None:
    image = smooth_image(40, 60)
    decoded = Decoded(open_sam(str(tiny)), image)
    loose = replace(mask_settings("fast"), predicted_iou=0.0, stability=0.0, least_score=0.0)
    found = cut(image, decoded, Rule(replace(loose, skip_covered=False)))
    painted, figures = found
    assert figures["points"] == 1024
    assert tuple(painted) == LEVELS
    assert all(set(np.unique(of)) - {-1} == set(range(int(of.max()) + 1)) for of in painted.values())
    assert cut(image, decoded, Rule(loose))[1]["points"] < 1024
    assert cut(image, decoded, Rule(replace(loose, points_per_side=4, crop_layers=1)))[1]["points"] <= 5 * 16
    assert tuple(cut(image, decoded, Rule(with_default=True))[0]) == (*LEVELS, "default")
    write_cut(found, tmp_path / "view, rule.npz")
    again, same = read_cut(tmp_path / "view, rule.npz")
    assert same == figures
    assert all((again[level] == painted[level]).all() for level in LEVELS)


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
