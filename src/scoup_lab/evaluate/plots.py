"""Plots of studies, drawn by matplotlib (``pip install 'scoup[eval]'``): points with intervals."""

from __future__ import annotations

import importlib.util
import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from scoup.base.errors import InputError
from scoup_lab.evaluate.metrics import Interval

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

HOW_TO_GET_THEM = "plots need the package matplotlib: pip install 'scoup[eval]', and run again"
_GREY = "#6e727a"
_ROW = 0.27  # inches


@dataclass(frozen=True)
class IntervalPlot:
    """Points with intervals, a row each, from top to bottom, under the heading of their group."""

    rows: Sequence[tuple[str, str, Interval]]  # (group, name, interval); rows of a group follow each other
    title: str
    x_label: str
    digits: int = 1  # of the means, after the point
    # where a line is drawn, such as 0 for differences; none if None. Its meaning belongs into ``x_label``.
    reference: float | None = None

    def figure(self) -> Figure:
        if not self.rows:
            raise InputError("a plot needs rows")
        places, names, headings, y = [], [], [], 0
        for number, (group, name, _) in enumerate(self.rows):
            if number == 0 or group != self.rows[number - 1][0]:
                headings.append((y, group))
                y += 1
            places.append(y)
            names.append(name)
            y += 1
        figure, axes = _axes(9.0, 1.1 + _ROW * y, self.title, self.x_label)
        if self.reference is not None:
            axes.axvline(self.reference, color=_GREY, linewidth=1.2)
        for place, (_, _, interval) in zip(places, self.rows, strict=True):
            axes.plot([interval.low, interval.high], [place, place], color="C0", alpha=0.6, linewidth=2)
            axes.plot([interval.mean], [place], color="C0", marker="o")
            sign = "" if self.reference is None else "+"
            text = f"{interval.mean:{sign}.{self.digits}f}"
            axes.text(1.02, place, text, transform=axes.get_yaxis_transform(), va="center")
        for place, group in headings:
            axes.text(0.01, place, group, transform=axes.get_yaxis_transform(), va="center", weight="bold")
        axes.set_yticks(places, names)
        axes.tick_params(axis="y", length=0)
        axes.grid(visible=False, axis="y")
        axes.set_ylim(y - 0.5, -0.5)
        return figure


def can_draw() -> bool:
    """Return whether matplotlib is installed."""
    return importlib.util.find_spec("matplotlib") is not None


def png(plot: IntervalPlot) -> bytes:
    """Return a plot as PNG: the same bytes for the same plot and version of matplotlib."""
    if not can_draw():
        raise InputError(HOW_TO_GET_THEM)
    stream = io.BytesIO()
    plot.figure().savefig(stream, format="png", metadata={"Software": None})
    return stream.getvalue()


def _axes(width: float, height: float, title: str, x_label: str) -> tuple[Figure, Axes]:
    """Return an empty figure, in inches; pyplot and its global state stay out of it."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.set_title(title, loc="left")
    axes.set_xlabel(x_label)
    axes.grid(color="#e2e4e8")
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(_GREY)
    return figure, axes
