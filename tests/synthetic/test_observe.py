"""Simulated regions and embeddings err as much as they are said to."""

from __future__ import annotations

import numpy as np
import torch

from scoup.scene import LEVELS
from scoup_lab.synthetic import DemoScene
from scoup_lab.synthetic.observe import make_regions


def cosines(rows: torch.Tensor) -> torch.Tensor:
    """Between all pairs of unit rows."""
    return (rows @ rows.T)[torch.ones(len(rows), len(rows), dtype=torch.bool).triu(1)]


def checkerboard(cell: int = 20, cells: int = 24) -> np.ndarray:
    """[480, 480] squares with a number each."""
    rows, columns = np.indices((cell * cells, cell * cells)) // cell
    return (rows * cells + columns).astype(np.int32)


def test_shares_of_errors_on_a_checkerboard():
    truth = checkerboard()
    labels = make_regions(truth, "m", np.random.default_rng(0))
    count = truth.max() + 1
    covered = np.bincount(truth[labels >= 0], minlength=count) / 400
    owners = [np.bincount(truth[labels == region], minlength=count) for region in range(labels.max() + 1)]
    # Grown neighbours cover some of a missing square, and a shrunk one may still be missing at its rim.
    assert 0.03 < (covered < 0.45).mean() < 0.1
    merged = np.mean([(sizes > 200).sum() > 1 for sizes in owners])
    assert 0.015 < merged < 0.08
    split = np.mean([(sizes.max() < 300) and (sizes.max() > 60) for sizes in owners])
    assert 0.03 < split < 0.25
    exact = np.mean([(sizes > 0).sum() == 1 and sizes.max() == 400 for sizes in owners])
    assert 0.4 < exact < 0.85


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


def test_levels_run_from_fine_to_coarse(scene: DemoScene):
    counts = [len(scene.regions.embeddings(level)[0]) for level in LEVELS]
    assert counts[0] > counts[1] > counts[2]
    for name in scene.regions.view_names:
        for level in LEVELS:
            found = scene.regions.load(name, level)
            assert (found.labels >= 0).float().mean() > 0.6
            assert (found.embeddings.norm(dim=1) - 1).abs().max() < 1e-5


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
