"""Plots: what is drawn, the same bytes again, no trace in the global state, and what happens without matplotlib."""

from __future__ import annotations

import importlib.util
import io
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from scoup.base.errors import InputError
from scoup_lab.evaluate.metrics import Interval
from scoup_lab.evaluate.plots import HOW_TO_GET_THEM, Curve, CurvePlot, IntervalPlot, Plot, png
from scoup_lab.evaluate.report import Report
from scoup_lab.evaluate.tables import Table

needs_matplotlib = pytest.mark.skipif(
    importlib.util.find_spec("matplotlib") is None, reason="matplotlib is not installed"
)

RISING = Curve("rising", (0, 1, 2), (Interval(10, 8, 12), Interval(20, 18, 22), Interval(30, 25, 35)))
FLAT = Curve("flat", (0, 1), (Interval(15, 15, 15), Interval(15, 15, 15)))
CURVES = CurvePlot([RISING, FLAT], "title", "x", "y")
INTERVALS = IntervalPlot(
    [
        ("first", "a", Interval(50, 40, 60)),
        ("first", "b", Interval(70, 68, 72)),
        ("next", "c", Interval(1, 1, 1)),
    ],
    "title",
    "x",
)


@needs_matplotlib
def test_curves_and_bands_are_those_given() -> None:
    (axes,) = CURVES.figure().axes
    assert [line.get_label() for line in axes.lines] == ["rising", "flat"]
    assert [list(np.asarray(line.get_ydata())) for line in axes.lines] == [[10, 20, 30], [15, 15]]
    low, high = axes.collections[0].get_datalim(axes.transData).intervaly
    assert (low, high) == (8, 35)
    assert len({line.get_color() for line in axes.lines}) == 2
    legend = axes.get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == ["rising", "flat"]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x", "y")


@needs_matplotlib
def test_intervals_stand_in_groups_from_top_to_bottom() -> None:
    (axes,) = INTERVALS.figure().axes
    spans = [list(np.asarray(line.get_xdata())) for line in axes.lines[::2]]
    assert spans == [[40, 60], [68, 72], [1, 1]]
    assert [label.get_text() for label in axes.get_yticklabels()] == ["a", "b", "c"]
    assert list(axes.get_yticks()) == [1, 2, 4]  # headings are at 0 and 3
    bottom, top = axes.get_ylim()
    assert bottom > top
    assert {"first", "next", "50.0", "70.0", "1.0"} <= {text.get_text() for text in axes.texts}


@needs_matplotlib
def test_differences_stand_beside_a_line() -> None:
    rows = [("first", "a", Interval(0.02, 0.01, 0.03)), ("first", "b", Interval(-0.02, -0.03, -0.01))]
    (axes,) = IntervalPlot(rows, "title", "x", 3, 0.0).figure().axes
    assert list(np.asarray(axes.lines[0].get_xdata())) == [0, 0]
    assert {"+0.020", "-0.020"} <= {text.get_text() for text in axes.texts}
    low, high = axes.get_xlim()
    assert low < -0.02 < 0 < 0.02 < high


@needs_matplotlib
@pytest.mark.parametrize("plot", [CURVES, INTERVALS])
def test_pictures_are_deterministic_and_pyplot_stays_out(plot: Plot) -> None:
    first = png(plot)
    assert png(plot) == first
    with Image.open(io.BytesIO(first)) as picture:
        assert min(picture.size) > 150
        assert np.asarray(picture.convert("L")).std() > 5
    assert "matplotlib.pyplot" not in sys.modules


@pytest.mark.parametrize(
    "plot",
    [
        CurvePlot([Curve("a", (), ())], "", "", ""),
        CurvePlot([Curve("a", (1, 2), (Interval(1, 1, 1),))], "", "", ""),
        IntervalPlot([], "", ""),
    ],
)
@needs_matplotlib
def test_what_cannot_be_drawn(plot: Plot) -> None:
    with pytest.raises(InputError):
        plot.figure()


def report() -> Report:
    return Report("study", "Study", [Table("t", ("a",), (("1",),))], {"a": 1}, {"p.png": CURVES})


@needs_matplotlib
def test_a_report_shows_its_plots(tmp_path: Path) -> None:
    written = report().write(tmp_path)
    assert {path.name for path in written} == {"study.md", "study.json", "study.tex", "p.png"}
    assert all(path.is_file() for path in written)
    assert "![p](p.png)" in (tmp_path / "study.md").read_text()


def test_without_matplotlib_a_report_is_its_tables(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    written = report().write(tmp_path)
    assert {path.name for path in written} == {"study.md", "study.json", "study.tex"}
    assert "png" not in (tmp_path / "study.md").read_text()
    with pytest.raises(InputError) as refused:
        png(CURVES)
    assert str(refused.value) == HOW_TO_GET_THEM
