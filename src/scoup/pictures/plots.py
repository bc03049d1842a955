"""Plain plots with Pillow: curves with bands, and points with intervals. No plotting library is needed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw

from scoup.base.errors import InputError
from scoup.pictures.colors import Picture, label_colors
from scoup.pictures.lettering import font, text_width

PAPER, INK, FAINT, GRID = (255, 255, 255), (30, 32, 36), (110, 114, 122), (226, 228, 232)
_TEXT = 15
_MARKERS = ("disc", "square", "diamond", "cross")


@dataclass(frozen=True)
class Series:
    """A curve.

    Attributes:
        name: for the legend.
        x, y: points, in order of x.
        low, high: ends of the interval of each, or none.
    """

    name: str
    x: tuple[float, ...]
    y: tuple[float, ...]
    low: tuple[float, ...] = ()
    high: tuple[float, ...] = ()


def line_plot(
    series: Sequence[Series],
    title: str,
    x_label: str,
    y_label: str,
    width: int = 900,
    height: int = 560,
    footer: str = "",
) -> Picture:
    """Curves with shaded intervals and a legend on the right.

    Args:
        series: at least one, each of one point or more.
        title, x_label, y_label, footer: written around.
        width, height: in pixels.

    Returns:
        [height, width, 3] uint8.

    Raises:
        InputError: there are no points, or lists of different lengths.
    """
    _check(series)
    legend = 20 + max(text_width(each.name, font(_TEXT)) for each in series) + 34
    left, top, right, bottom = 74, 66, width - legend, height - (72 if footer else 52)
    xs = [value for each in series for value in each.x]
    ys = [value for each in series for value in (*each.y, *each.low, *each.high)]
    x_ticks, y_ticks = nice_ticks(min(xs), max(xs)), nice_ticks(min(ys), max(ys))
    x_span = min(min(xs), x_ticks[0]), max(max(xs), x_ticks[-1])
    y_span = min(y_ticks[0], min(ys)), max(y_ticks[-1], max(ys))

    def place(x: float, y: float) -> tuple[float, float]:
        across = (x - x_span[0]) / max(x_span[1] - x_span[0], 1e-12)
        up = (y - y_span[0]) / max(y_span[1] - y_span[0], 1e-12)
        return left + across * (right - left), bottom - up * (bottom - top)

    canvas = Image.new("RGB", (width, height), PAPER)
    draw = ImageDraw.Draw(canvas, "RGBA")
    for tick in y_ticks:
        y = place(x_span[0], tick)[1]
        draw.line((left, y, right, y), GRID)
        draw.text((left - 8, y), _number(tick), FAINT, font(_TEXT), anchor="rm")
    for tick in x_ticks:
        x = place(tick, y_span[0])[0]
        draw.line((x, top, x, bottom), GRID)
        draw.text((x, bottom + 8), _number(tick), FAINT, font(_TEXT), anchor="mt")
    draw.line((left, top, left, bottom, right, bottom), FAINT)
    colors = plot_colors(len(series))
    for each, color in zip(series, colors, strict=True):
        if each.low:
            ends = [place(x, y) for x, y in zip(each.x, each.high, strict=True)]
            ends += [place(x, y) for x, y in zip(reversed(each.x), reversed(each.low), strict=True)]
            if len(each.x) > 1:
                draw.polygon(ends, fill=(*color, 26))
    for number, (each, color) in enumerate(zip(series, colors, strict=True)):
        points = [place(x, y) for x, y in zip(each.x, each.y, strict=True)]
        draw.line(points, fill=color, width=3, joint="curve")
        for point in points:
            _marker(draw, point, color, number)
        y = top + 12 + 24 * number
        draw.line((right + 14, y, right + 38, y), color, 3)
        _marker(draw, (right + 26, y), color, number)
        draw.text((right + 46, y), each.name, INK, font(_TEXT), anchor="lm")
    _around(draw, title, x_label, y_label, footer, (left, top, right, bottom), height)
    return np.asarray(canvas)


def interval_plot(
    rows: Sequence[tuple[str, float, float, float]],
    title: str,
    x_label: str,
    width: int = 900,
    headings: Sequence[str] = (),
    footer: str = "",
    digits: int = 1,
) -> Picture:
    """Points with intervals, a line each, from top to bottom.

    Args:
        rows: (name, mean, low, high).
        title, x_label, footer: written around.
        width: in pixels; the height follows from the rows.
        headings: group of each row, or none; a heading stands above the first row of each group.
        digits: of the means, after the point.

    Raises:
        InputError: there are no rows, or headings do not fit them.
    """
    if not rows or (headings and len(headings) != len(rows)):
        raise InputError(f"{len(rows)} rows and {len(headings)} headings make no plot")
    groups = headings or [""] * len(rows)
    lines: list[tuple[str, tuple[str, float, float, float] | None]] = []
    for number, (row, group) in enumerate(zip(rows, groups, strict=True)):
        if group and (number == 0 or groups[number - 1] != group):
            lines.append((group, None))
        lines.append((row[0], row))
    step = 26
    left = 40 + max(text_width(name, font(_TEXT)) for name, _ in lines)
    top, right = 48, width - 90
    bottom = top + step * len(lines)
    height = bottom + (72 if footer else 52)
    ticks = nice_ticks(min(row[2] for row in rows), max(row[3] for row in rows))
    low = min(ticks[0], min(row[2] for row in rows))
    high = max(ticks[-1], max(row[3] for row in rows))

    def across(value: float) -> float:
        return left + (value - low) / max(high - low, 1e-12) * (right - left)

    canvas = Image.new("RGB", (width, height), PAPER)
    draw = ImageDraw.Draw(canvas, "RGBA")
    for tick in ticks:
        draw.line((across(tick), top, across(tick), bottom), GRID)
        draw.text((across(tick), bottom + 8), _number(tick), FAINT, font(_TEXT), anchor="mt")
    color = plot_colors(1)[0]
    for number, (name, row) in enumerate(lines):
        y = top + step * (number + 0.5)
        if row is None:
            draw.text((12, y), name, INK, font(_TEXT + 1), anchor="lm")
            draw.line((12, y + 11, right, y + 11), GRID)
            continue
        _, mean, least, most = row
        draw.text((left - 12, y), name, FAINT, font(_TEXT), anchor="rm")
        draw.line((across(least), y, across(most), y), (*color, 150), 3)
        _marker(draw, (across(mean), y), color, 0)
        draw.text((right + 12, y), f"{mean:.{digits}f}", INK, font(_TEXT), anchor="lm")
    _around(draw, title, x_label, "", footer, (left, top, right, bottom), height)
    return np.asarray(canvas)


def nice_ticks(low: float, high: float, most: int = 6) -> list[float]:
    """Round numbers that span low to high, at most ``most`` + 1 of them."""
    if not (math.isfinite(low) and math.isfinite(high)):
        raise InputError(f"an axis from {low} to {high} cannot be drawn")
    if high - low < 1e-12 * max(1.0, abs(low)):
        low, high = low - 0.5, high + 0.5
    raw = (high - low) / most
    magnitude = 10.0 ** math.floor(math.log10(raw))
    step = next(factor * magnitude for factor in (1, 2, 2.5, 5, 10) if factor * magnitude >= raw * (1 - 1e-9))
    first, last = math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9)
    while last - first > most:
        step *= 2
        first, last = math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9)
    return [round(number * step, 12) for number in range(first, last + 1)]


def plot_colors(count: int) -> list[tuple[int, int, int]]:
    """Colours dark enough for lines on white, easy to tell apart."""
    base = [
        (214, 69, 46), (38, 112, 184), (52, 150, 84), (146, 82, 170), (226, 146, 24), (90, 96, 106), (22, 170, 190),
        (128, 74, 44), (224, 110, 164),
    ]  # fmt: skip
    more = [tuple(int(value * 0.72) for value in color) for color in label_colors(max(count, 1))]
    return (base + more[len(base) :])[:count] if count > len(base) else base[:count]  # pyright: ignore[reportReturnType]


def _check(series: Sequence[Series]) -> None:
    if not series or not all(each.x for each in series):
        raise InputError("a plot needs points")
    for each in series:
        lengths = {len(each.x), len(each.y), len(each.low or each.x), len(each.high or each.x)}
        if len(lengths) > 1 or bool(each.low) != bool(each.high):
            raise InputError(f"the curve {each.name!r} has lists of different lengths")


def _around(
    draw: ImageDraw.ImageDraw,
    title: str,
    x_label: str,
    y_label: str,
    footer: str,
    frame: tuple[int, int, int, int],
    height: int,
) -> None:
    left, top, right, bottom = frame
    draw.text((12, 20), title, INK, font(_TEXT + 4), anchor="lm")
    draw.text(((left + right) / 2, bottom + 38), x_label, INK, font(_TEXT), anchor="mm")
    if y_label:
        draw.text((left, top - 10), y_label, FAINT, font(_TEXT - 1), anchor="lb")
    if footer:
        draw.text((12, height - 12), footer, FAINT, font(_TEXT - 2), anchor="lb")


def _marker(
    draw: ImageDraw.ImageDraw, point: tuple[float, float], color: tuple[int, int, int], number: int
) -> None:
    x, y, size = *point, 5
    kind = _MARKERS[number % len(_MARKERS)]
    if kind == "disc":
        draw.ellipse((x - size, y - size, x + size, y + size), fill=color)
    elif kind == "square":
        draw.rectangle((x - size + 1, y - size + 1, x + size - 1, y + size - 1), fill=color)
    elif kind == "diamond":
        draw.polygon([(x, y - size - 1), (x + size + 1, y), (x, y + size + 1), (x - size - 1, y)], fill=color)
    else:
        draw.line((x - size, y - size, x + size, y + size), color, 3)
        draw.line((x - size, y + size, x + size, y - size), color, 3)


def _number(value: float) -> str:
    return f"{value:.4g}"
