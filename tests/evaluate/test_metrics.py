"""Scores by hand, and the bootstrap by its properties."""

from __future__ import annotations

import pytest
import torch

from messages import refuses
from scoup_lab.evaluate.metrics import Interval, any_inside, bootstrap_interval, iou


def test_iou() -> None:
    first = torch.tensor([[True, True, False], [False, False, False]])
    second = torch.tensor([[False, True, True], [False, False, False]])
    assert iou(first, second) == pytest.approx(1 / 3)
    assert iou(first, first) == 1
    assert iou(first, ~first) == 0
    assert iou(torch.zeros(2, 2, dtype=torch.bool), torch.zeros(2, 2, dtype=torch.bool)) == 1
    with refuses():
        iou(first, second.T)


def test_points_on_borders_are_inside() -> None:
    boxes = torch.tensor([[10.0, 20.0, 30.0, 40.0], [50.5, 50.5, 51.5, 51.5]])
    for x, y, expected in ((10, 20, True), (30, 40, True), (9, 20, False), (30, 41, False), (51, 51, True)):
        assert any_inside(torch.tensor([[x, y]]), boxes) is expected
    assert any_inside(torch.tensor([[0, 0], [51, 51]]), boxes)
    assert not any_inside(torch.zeros(0, 2, dtype=torch.long), boxes)


def test_bootstrap() -> None:
    values = [0.0, 1.0] * 50
    many = bootstrap_interval(values, [str(index) for index in range(100)])
    assert many.mean == 0.5
    assert 0.37 < many.low < 0.45 < 0.55 < many.high < 0.63
    assert bootstrap_interval(values, [str(index) for index in range(100)]) == many
    # Values of one query stand and fall together: fewer independent draws, a wider interval.
    few = bootstrap_interval([0.0] * 50 + [1.0] * 50, [str(index // 10) for index in range(100)])
    assert few.high - few.low > many.high - many.low
    assert bootstrap_interval([0.3, 0.3], ["a", "b"]).low == pytest.approx(0.3)
    assert bootstrap_interval([0.5], ["a"]) == Interval(0.5, 0.5, 0.5)
    for wrong in (([], []), ([1.0], []), ([float("nan")], ["a"])):
        with refuses():
            bootstrap_interval(*wrong)


def test_each_scene_counts_alike() -> None:
    values, groups = [1.0, 0.0, 0.0, 0.0], ["cup", "cup", "pot", "fork"]
    whole = bootstrap_interval(values, groups)
    assert whole == bootstrap_interval(values, groups, scenes=["a"] * 4)
    assert whole.mean == 0.25
    # A scene of one value and a scene of three; neither can be drawn away.
    apart = bootstrap_interval(values, groups, scenes=["a", "b", "b", "b"])
    assert apart.mean == 0.5
    assert (apart.low, apart.high) == (0.5, 0.5)
    with refuses():
        bootstrap_interval(values, groups, scenes=["a"])
