"""Presence: signals by hand, a model that tells what it was shown, its file."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from scoup import raster
from scoup.errors import FileFormatError, InputError, MissingFileError, OutputExistsError
from scoup.pipeline import build
from scoup.presence import (
    SIGNALS,
    PresenceModel,
    fit_presence,
    load_presence,
    rendered_mean,
    save_presence,
    scene_presence,
    signals_of,
    view_presence,
    vote_entropy,
)
from scoup.query import PRESETS, segment
from support import small_scene, unit

MODEL = PresenceModel(SIGNALS, (0.6, 0.6, 0.1), (0.05, 0.05, 0.05), (1.0, 0.5, -0.25), 0.2)


def test_entropy_of_votes() -> None:
    weights = torch.tensor(
        [[[1.0, 0, 0, 0]], [[0.25, 0.25, 0.25, 0.25]], [[0, 0, 0, 0.0]], [[2.0, 2.0, 0, 0]]]
    )
    assert vote_entropy(weights)[:, 0].tolist() == pytest.approx([0, 1, 1, 0.5])
    assert vote_entropy(weights * 7)[:, 0].tolist() == pytest.approx([0, 1, 1, 0.5])


def test_signals_by_hand() -> None:
    maps = torch.full((2, 20, 30), 0.4)
    maps[1, 4:14, 6:20] = 0.8
    found = signals_of(maps)
    mask = segment(maps).mask
    smoothed = 0.5 * (maps[1] + box(maps[1]))
    assert found[0] == pytest.approx(float(smoothed.max()))
    assert found[1] == pytest.approx(float(smoothed[mask].mean()), abs=1e-6)
    assert found[2] == pytest.approx(float(smoothed[mask].mean() - smoothed[~mask].mean()), abs=1e-6)
    extra = torch.rand(2, 20, 30)
    assert signals_of(maps, [extra])[3] == pytest.approx(float(extra[1][mask].mean()), abs=1e-6)


def box(values: torch.Tensor) -> torch.Tensor:
    """Mean over 7 x 7 pixels inside the image, by torch's own pooling."""
    pooled = torch.nn.functional.avg_pool2d(values[None, None], 7, 1, 3, count_include_pad=False)
    return pooled[0, 0]


def test_a_constant_map_answers_nothing() -> None:
    assert signals_of(torch.full((3, 9, 9), 0.5)).tolist() == [0.5, 0.5, 0.0]
    extra = torch.rand(3, 9, 9)
    assert signals_of(torch.full((3, 9, 9), 0.5), [extra])[3] == pytest.approx(float(extra[0].mean()))


def test_fit_tells_classes_apart_and_weighs_them_alike() -> None:
    random = torch.Generator().manual_seed(0)
    rows = torch.randn(400, 3, generator=random)
    present = rows[:, 0] + 0.3 * torch.randn(400, generator=random) > 0
    model = fit_presence(rows, present)
    chance = model.probability(rows)
    assert ((chance > 0.5) == present).float().mean() > 0.85
    assert model.weights[0] > 5 * max(abs(model.weights[1]), abs(model.weights[2]))
    # Many more of one class: as many of the rare class are told as of the other.
    keep = present | (torch.arange(400) % 8 == 0)
    skewed = fit_presence(rows[keep], present[keep]).probability(rows) > 0.5
    rates = (skewed[present].float().mean(), (~skewed)[~present].float().mean())
    assert abs(float(rates[0] - rates[1])) < 0.12


def test_fit_is_the_minimum_of_its_loss() -> None:
    """Newton's result against small steps away from it."""
    random = torch.Generator().manual_seed(1)
    rows = torch.randn(60, 3, generator=random).double()
    present = rows.sum(1) + torch.randn(60, generator=random) > 0.5
    model = fit_presence(rows, present)
    importance = torch.where(present, 0.5 / present.sum(), 0.5 / (~present).sum()) * 60
    units = (rows - torch.tensor(model.center)) / torch.tensor(model.scale)

    def loss(weights: torch.Tensor, bias: float) -> float:
        chance = torch.sigmoid(units @ weights + bias)
        likelihood = torch.where(present, chance.log(), (1 - chance).log())
        return float(-(importance * likelihood).sum() + 0.5 * 0.01 * 60 * (weights**2).sum())

    weights = torch.tensor(model.weights).double()
    best = loss(weights, model.bias)
    for axis in range(3):
        for step in (-0.01, 0.01):
            moved = weights.clone()
            moved[axis] += step
            assert loss(moved, model.bias) > best
    assert min(loss(weights, model.bias + 0.01), loss(weights, model.bias - 0.01)) > best


def test_classes_that_part_do_not_run_away() -> None:
    rows = torch.cat([torch.zeros(10, 3), torch.ones(10, 3)])
    model = fit_presence(rows, torch.arange(20) >= 10)
    assert all(math.isfinite(weight) and abs(weight) < 20 for weight in (*model.weights, model.bias))


@pytest.mark.parametrize("present", [torch.zeros(4, dtype=torch.bool), torch.ones(4, dtype=torch.bool)])
def test_both_classes_are_needed(present: torch.Tensor) -> None:
    with pytest.raises(InputError, match="both kinds"):
        fit_presence(torch.rand(4, 3), present)
    with pytest.raises(InputError, match="do not fit"):
        fit_presence(torch.rand(4, 2), torch.arange(4) > 1)


def test_rendered_means_are_over_coded_gaussians() -> None:
    gaussians, cameras, _ = small_scene(count=40, views=1)
    view = raster.look(gaussians, cameras[0])
    values = torch.rand(40, 3, generator=torch.Generator().manual_seed(0))
    coded = torch.rand(40, 3, generator=torch.Generator().manual_seed(1)) > 0.4
    weights = raster.render_channels(view, torch.eye(40))[0]
    found = rendered_mean(view, values, coded)
    for level in range(3):
        counted = coded[:, level].float()
        total = weights @ counted
        expected = torch.where(
            total > 1e-6, weights @ (counted * values[:, level]) / total.clamp(min=1e-6), 1.0
        )
        assert torch.allclose(found[level], expected, atol=1e-4)


def test_presence_in_a_scene_is_the_largest_over_views() -> None:
    gaussians, cameras, regions = small_scene(count=80, views=3)
    field = build(gaussians, cameras, regions, n_atoms=8)
    queries, canonical = unit(torch.randn(2, 16)), unit(torch.randn(3, 16))
    found = scene_presence(field, cameras, queries, canonical, MODEL)
    for query in range(2):
        chances = [
            view_presence(field.relevancy(camera, queries, canonical)[:, query], MODEL) for camera in cameras
        ]
        assert float(found[query]) == pytest.approx(max(chances))
    with pytest.raises(InputError, match="there are none"):
        scene_presence(field, [], queries, canonical, MODEL)
    with pytest.raises(InputError, match="takes peak"):
        view_presence(torch.rand(3, 9, 9), replace(MODEL, signals=("peak",)), PRESETS["default"])


def test_file(tmp_path: Path) -> None:
    path = tmp_path / "model.json"
    model = replace(MODEL, scene_threshold=0.75, calibrated_on="two scenes")
    save_presence(model, path)
    assert load_presence(path) == model
    with pytest.raises(OutputExistsError):
        save_presence(model, path)
    with pytest.raises(MissingFileError, match="scoup eval presence"):
        load_presence(tmp_path / "absent.json")


@pytest.mark.parametrize(
    "change",
    [
        {"kind": "other"}, {"version": 2}, {"weights": [1.0]}, {"scale": [0.0, 1.0, 1.0]}, {"bias": None},
        {"bias": "x"}, {"center": 3}, {"center": [1.0, float("nan"), 1.0]},
    ],
)  # fmt: skip
def test_damaged_file(tmp_path: Path, change: dict) -> None:
    path = tmp_path / "model.json"
    save_presence(MODEL, path)
    path.write_text(json.dumps({**json.loads(path.read_text()), **change}))
    with pytest.raises(FileFormatError, match=r"model\.json"):
        load_presence(path)
