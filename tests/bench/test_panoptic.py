"""Panoptic maps with faults, and what the study of them scores."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from benchmarks.panoptic import accuracy_and_miou, classes_of
from benchmarks.panoptic_maps import PanopticTruth, class_vectors, make_panoptic_maps, segments

from scoup_lab.bench import random_scene_cameras, random_scene_gaussians

COUNT = 12


def truth() -> PanopticTruth:
    """Blocks of 12 classes, the same in every view: enough for the maps, which know nothing of Gaussians."""
    cameras = random_scene_cameras(8, 240, 180)
    shown = np.repeat(np.repeat(np.arange(COUNT, dtype=np.int32).reshape(3, 4), 60, 0), 60, 1)
    groups = np.arange(COUNT) // 3
    return PanopticTruth(
        "blocks",
        random_scene_gaussians(10),
        cameras,
        cameras,
        {camera.name: shown for camera in cameras},
        np.zeros(10, np.int64),
        groups,
        np.ones(COUNT, bool),
    )


def test_a_seed_gives_the_same_maps_with_one_vector_a_class() -> None:
    first, again, other = (make_panoptic_maps(truth(), seed) for seed in (3, 3, 4))
    rows, of_views = first.regions.embeddings("m")
    assert rows.equal(first.vectors[torch.from_numpy(first.classes)])
    assert rows.equal(again.regions.embeddings("m")[0])
    assert not np.array_equal(first.classes, other.classes)
    assert len(rows.unique(dim=0)) <= COUNT < len(rows)
    for name, part in of_views.items():
        labels = first.regions.load(name, "m").labels
        assert labels.equal(again.regions.load(name, "m").labels)
        assert int(labels.max()) == part.stop - part.start - 1


def test_maps_are_mostly_right_but_not_quite() -> None:
    right = []
    made = truth()
    for seed in range(4):
        maps = make_panoptic_maps(made, seed)
        for name, rows in maps.regions.embeddings("m")[1].items():
            labels = maps.regions.load(name, "m").labels.numpy()
            found = np.append(maps.classes[rows], -1)[labels]
            right.append(float((found == made.shown[name]).mean()))
    assert 0.55 < np.mean(right) < 0.9
    assert min(right) < 0.8 < max(right)


def test_segments_belong_to_what_is_there() -> None:
    shown = next(iter(truth().shown.values()))
    labels, true = segments(shown, np.random.default_rng(0))
    assert sorted(np.unique(labels[labels >= 0])) == list(range(len(true)))
    inside = [np.bincount(shown[labels == number]).argmax() for number in range(len(true))]
    assert np.mean(np.array(inside) == true) > 0.8


def test_class_vectors_are_like_those_of_clip() -> None:
    groups = np.repeat(np.arange(10), 3)
    vectors = class_vectors(groups, np.random.default_rng(0))
    cosines = vectors @ vectors.T
    related = (groups[:, None] == groups) & ~np.eye(30, dtype=bool)
    np.testing.assert_allclose(np.diag(cosines), 1)
    assert 0.75 < cosines[related].min() < cosines[related].max() < 0.95
    assert np.median(cosines[groups[:, None] != groups]) == pytest.approx(0.55, abs=0.03)


def test_accuracy_and_miou_of_a_worked_example() -> None:
    found, true = np.array([0, 0, 1, -1, 1, 2]), np.array([0, 0, 0, 1, 1, -1])
    accuracy, miou = accuracy_and_miou(found, true, np.ones(3, bool))
    assert accuracy == pytest.approx(3 / 5)
    assert miou == pytest.approx((2 / 3 + 1 / 3) / 2)
    only_first = accuracy_and_miou(found, true, np.array([True, False, False]))
    assert only_first == (pytest.approx(2 / 3), pytest.approx(2 / 3))
    assert classes_of(torch.tensor([[0.2, 0.5], [0.0, 0.0]])).tolist() == [1, -1]
