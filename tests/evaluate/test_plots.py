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
from scoup_lab.evaluate.plots import HOW_TO_GET_THEM, IntervalPlot, png
from scoup_lab.evaluate.report import Report
from scoup_lab.evaluate.tables import Table

needs_matplotlib = pytest.mark.skipif(
    importlib.util.find_spec("matplotlib") is None, reason="matplotlib is not installed"
)

ROWS = [
    ("first", "a", Interval(50, 40, 60)),
    ("first", "b", Interval(70, 68, 72)),
    ("next", "c", Interval(1, 1, 1)),
]
INTERVALS = IntervalPlot(ROWS, "title", "x")


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
def test_pictures_are_deterministic_and_pyplot_stays_out() -> None:
    first = png(INTERVALS)
    assert png(INTERVALS) == first
    with Image.open(io.BytesIO(first)) as picture:
        assert min(picture.size) > 150
        assert np.asarray(picture.convert("L")).std() > 5
    assert "matplotlib.pyplot" not in sys.modules


@needs_matplotlib
def test_a_plot_needs_rows() -> None:
    with pytest.raises(InputError):
        IntervalPlot([], "", "").figure()


def report() -> Report:
    return Report("study", "Study", [Table("t", ("a",), (("1",),))], {"a": 1}, {"p.png": INTERVALS})


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
        png(INTERVALS)
    assert str(refused.value) == HOW_TO_GET_THEM
