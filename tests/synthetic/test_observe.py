"""Simulated regions and embeddings err as much as they are said to."""

from __future__ import annotations

import numpy as np
import torch

from scoup_lab.synthetic import DemoScene
from scoup_lab.synthetic.observe import make_regions


def cosines(rows: torch.Tensor) -> torch.Tensor:
    """Between all pairs of unit rows."""
    return (rows @ rows.T)[torch.ones(len(rows), len(rows), dtype=torch.bool).triu(1)]


def test_regions_are_numbered_without_gaps_and_small_ones_dropped():
    truth = np.full((60, 80), -1, np.int32)
    truth[10:40, 10:50] = 3
    truth[50:52, 60:63] = 5
    for seed in range(10):
        labels = make_regions(truth, "s", np.random.default_rng(seed))
        assert labels.dtype == np.int32
        found = np.unique(labels[labels >= 0])
        assert found.tolist() == list(range(len(found)))
        assert (labels[50:52, 60:63] < 0).all()


def test_maps_without_anything_have_no_regions():
    labels = make_regions(np.full((40, 40), -1, np.int32), "l", np.random.default_rng(0))
    assert (labels == -1).all()


def test_region_embeddings_have_the_stated_statistics(scene: DemoScene):
    own, by_name = [], {}
    for view in scene.regions.view_names:
        truth = scene.parts.at_level(scene.part_maps[view], "m")
        found = scene.regions.load(view, "m")
        for region, vector in enumerate(found.embeddings):
            inside = truth[(found.labels == region).numpy()]
            number = int(np.bincount(inside[inside >= 0]).argmax())
            by_name.setdefault(number, []).append(vector)
            own.append(float(vector @ scene.text_vectors([scene.parts.objects[number]])[0]))
    low, middle, high = np.percentile(own, [15, 50, 90])
    assert low > 0.17
    assert 0.23 < middle < 0.28
    assert 0.26 < high < 0.31
    same = torch.cat([cosines(torch.stack(rows)) for rows in by_name.values()])
    assert 0.72 < same.median() < 0.9
    rows = scene.regions.embeddings("m")[0]
    between = cosines(rows)
    assert 0.45 < between.median() < 0.65
