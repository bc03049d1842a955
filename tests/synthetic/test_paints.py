"""Paints: graphs of array operations, and the noise that most of them have."""

from __future__ import annotations

import numpy as np
import pytest

from scoup_lab.synthetic.art.paints import paint_of, smooth_noise


def test_a_graph_is_evaluated_in_its_order() -> None:
    points = np.random.default_rng(0).normal(size=(50, 3)) * 5
    normals = points / np.linalg.norm(points, axis=1, keepdims=True)
    graph = [
        ["column", "points", 2],
        ["greater", "#0", 1.5],
        ["expand", "#1"],
        ["noise", "normals", [2.5, 5, 0.8], 12],
        ["expand", "#3"],
        ["where", "#2", [0.2, 0.4, 0.6], "#4"],
    ]
    above = (points[:, 2] > 1.5)[:, None]
    shown = np.where(above, [0.2, 0.4, 0.6], smooth_noise(normals, (2.5, 5, 0.8), 12)[:, None])
    assert np.array_equal(paint_of(graph)(points, normals), shown)


def test_a_row_is_taken_for_each_number() -> None:
    points = np.array([[2.7, 0, 0], [0.1, 0, 0], [1.4, 0, 0]])
    colors = [[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]]
    graph = [["column", "points", 0], ["floor", "#0"], ["integer", "#1"], ["take", colors, "#2"]]
    assert np.array_equal(paint_of(graph)(points, points), np.array(colors)[[2, 0, 1]])


def test_noise_is_smooth_bounded_and_the_same_each_time():
    points = np.random.default_rng(1).uniform(-50, 50, (4000, 3))
    values = smooth_noise(points, 3.0, 4)
    assert np.abs(values).max() <= 1
    assert values.std() > 0.2
    assert np.abs(smooth_noise(points + 1e-6, 3.0, 4) - values).max() < 1e-4
    assert (smooth_noise(points, 3.0, 5) != values).any()
    assert smooth_noise(np.array([[0.5, 1.5, -2.5]]), 1.0, 7) == pytest.approx(
        smooth_noise(np.array([[0.5, 1.5, -2.5]]), 1.0, 7)
    )
