"""Legends of the colours of a picture."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw

from scoup.pictures.colors import BACKDROP, STRONGEST, Picture, heat_amounts, heat_colors, heat_opacity
from scoup.pictures.lettering import (
    FAINT,
    INK,
    LEAST_WIDTH,
    PAPER,
    font,
    lines_of,
    stacked,
    strip_height,
    text_width,
)

DRAW = 0.5  # relevancy where a query fits as well as the best canonical phrase
_DRAW_LABELS = ("0.5: draw with the canonical phrases", "0.5: draw", "0.5")


def heat_legend(picture: Picture, low: float, high: float) -> Picture:
    """Return a picture above its legend: the colours of a heat map along the whole scale of relevancy, with ticks at 0,
    0.5 and 1. The colours end at ``low`` and ``high``, the largest of the map: the scale is empty beyond it."""
    width = max(picture.shape[1], LEAST_WIDTH)
    height = strip_height(width)
    size = max(9, height * 0.42)
    face = font(size)
    start, end, top, bottom = *scale_ends(width), height // 4, height // 4 + max(8, round(height * 0.5))
    canvas = Image.new("RGB", (width, bottom + 6 + round(size * 1.5)), PAPER)
    draw = ImageDraw.Draw(canvas)
    relevancy = np.linspace(0, 1, end - start + 1)
    canvas.paste(_bar(relevancy, low, high, bottom - top), (start, top))
    draw.rectangle((start - 1, top - 1, end + 1, bottom), outline=FAINT)
    for tick in (0, DRAW, 1):
        x = start + round(tick * (end - start))
        draw.line((x, bottom, x, bottom + 4), fill=INK)
    y = bottom + 6 + size * 0.6
    draw.text((start, y), "0", INK, face, anchor="mm")
    draw.text((end, y), "1", INK, face, anchor="mm")
    room = end - start - 4 * size
    label = next((text for text in _DRAW_LABELS if text_width(text, face) <= room), "")
    draw.text(((start + end) / 2, y), label, INK, face, anchor="mm")
    _ends(draw, (start, top, end, bottom), low, high)
    return stacked([picture, np.asarray(canvas)])


def scale_ends(width: int) -> tuple[int, int]:
    """Return the columns of relevancy 0 and 1 in a ``heat_legend`` of this width."""
    margin = max(8, strip_height(width) // 2)
    return margin, width - 1 - margin


def _bar(relevancy: np.ndarray, low: float, high: float, height: int) -> Image.Image:
    amounts = heat_amounts(relevancy, (low, high))
    opacity = STRONGEST * heat_opacity(amounts)[:, None]  # as in the map, over mid grey
    bar = heat_colors(amounts) * opacity + 255 * BACKDROP * 0.5 * (1 - opacity)
    bar = np.where((relevancy > high)[:, None], PAPER, bar).astype(np.uint8)
    return Image.fromarray(np.broadcast_to(bar, (height, *bar.shape)).copy())


def _ends(draw: ImageDraw.ImageDraw, box: tuple[int, int, int, int], low: float, high: float) -> None:
    """Draw into the bar where the picture stays clear, and where the scale ends, if there is room."""
    start, top, end, bottom = box
    face = font(max(9, (bottom - top) * 0.7))
    middle, gap = (top + bottom) / 2, 6
    for text, x, room, anchor in (
        (f"clear below {low:.2f}", start + gap, low, "lm"),
        (f"largest {high:.2f}", end - gap, 1 - high, "rm"),
    ):
        if text_width(text, face) + 2 * gap <= room * (end - start):
            draw.text((x, middle), text, INK if anchor == "lm" else FAINT, face, anchor=anchor)


def swatch_legend(
    picture: Picture, text: str, of: str, colors: Sequence[tuple[int, int, int]], names: Sequence[str]
) -> Picture:
    """Return a picture above its legend: the meaning of its colours, and below it ``of`` and the colours (sRGB 0..255)
    with their names, as many as fit."""
    width = max(picture.shape[1], LEAST_WIDTH)
    size = max(9.0, strip_height(width) * 0.42)
    side, step = round(size * 1.1), round(size * 1.7)
    gap = max(3, side // 3)
    lines, face = lines_of(text, width - 2 * gap, size)
    canvas = Image.new("RGB", (width, step * (len(lines) + 1) + gap), PAPER)
    draw = ImageDraw.Draw(canvas)
    for number, line in enumerate(lines):
        draw.text((gap, gap + step * (number + 0.5)), line, INK, face, anchor="lm")
    middle = gap + step * (len(lines) + 0.5)
    x = gap
    if text_width(of, face) < width / 3:
        draw.text((x, middle), of, FAINT, face, anchor="lm")
        x += text_width(of, face) + 2 * gap
    for color, name in zip(colors, names, strict=True):
        after = x + side + gap + text_width(name, face)
        if after + gap > width:
            break
        draw.rectangle((x, middle - side / 2, x + side, middle + side / 2), fill=color, outline=FAINT)
        draw.text((x + side + gap, middle), name, INK, face, anchor="lm")
        x = after + 2 * gap
    return stacked([picture, np.asarray(canvas)])
