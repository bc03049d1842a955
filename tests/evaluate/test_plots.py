"""Plots: ticks that are round, pictures that hold what they should."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scoup.base.errors import InputError
from scoup.pictures.plots import Series, interval_plot, line_plot, nice_ticks, plot_colors


@given(st.floats(-1e6, 1e6), st.floats(1e-6, 1e6))
def test_ticks_span_the_data_and_are_evenly_spread(low: float, span: float) -> None:
    ticks = nice_ticks(low, low + span)
    assert 2 <= len(ticks) <= 8
    step = ticks[1] - ticks[0]
    assert step > 0
    assert np.allclose(np.diff(ticks), step, rtol=1e-6)
    assert ticks[0] <= low + 1e-6 * step + 1e-9
    assert ticks[-1] >= low + span - 1e-6 * max(step, abs(low) * 1e-6) - 1e-9


def test_ticks_by_hand() -> None:
    assert nice_ticks(0, 8) == [0, 2, 4, 6, 8]
    assert nice_ticks(31, 69) == [30, 40, 50, 60, 70]
    assert nice_ticks(0.5, 0.5) == pytest.approx([0, 0.2, 0.4, 0.6, 0.8, 1.0])
    with pytest.raises(InputError):
        nice_ticks(0, float("nan"))


def places(picture: np.ndarray, color: tuple[int, int, int]) -> np.ndarray:
    return np.argwhere((picture == np.array(color)).all(2))


def test_a_rising_curve_rises() -> None:
    plot = line_plot([Series("a", (0, 1), (0.0, 1.0))], "t", "x", "y", 500, 400)
    assert plot.shape == (400, 500, 3)
    assert plot.dtype == np.uint8
    found = places(plot, plot_colors(1)[0])
    found = found[found[:, 1] < 350]  # not the legend
    left, right = found[found[:, 1].argmin()], found[found[:, 1].argmax()]
    assert left[0] > right[0] + 150


def test_intervals_are_as_long_as_they_should_be() -> None:
    rows = [("a", 50.0, 40.0, 60.0), ("b", 70.0, 68.0, 72.0)]
    plot = interval_plot(rows, "t", "x", 700, ["g", "g"])
    color = plot_colors(1)[0]
    line = tuple(round(150 / 255 * part + 105 / 255 * 255) for part in color)
    near = (np.abs(plot.astype(int) - np.array(line)) <= 2).all(2)
    lengths = sorted(count for count in near.sum(1) if count > 5)
    assert lengths[-1] > 3 * lengths[0]


@pytest.mark.parametrize(
    "series", [[], [Series("a", (), ())], [Series("a", (1, 2), (1,))], [Series("a", (1,), (1,), (1,), ())]]
)
def test_bad_series(series: list[Series]) -> None:
    with pytest.raises(InputError):
        line_plot(series, "t", "x", "y")
    with pytest.raises(InputError):
        interval_plot([], "t", "x")


def test_many_curves_have_different_colors() -> None:
    assert len(set(plot_colors(12))) == 12
    first = [np.array(color) for color in plot_colors(9)]
    assert min(np.abs(a - b).max() for i, a in enumerate(first) for b in first[:i]) > 40
