"""Answers drawn over the colour render ``rgb`` [H, W, 3]: heat maps of relevancy [H, W] 0..1, masks [H, W] bool, boxes
(x0, y0, x1, y1) in pixels, x1 and y1 one past the last, points (x, y) as crosses, regions.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw

from scoup.base import InputError
from scoup.pictures.colors import (
    BACKDROP,
    STRONGEST,
    ArrayOrTensor,
    Picture,
    as_array,
    as_picture,
    grey,
    heat_amounts,
    heat_colors,
    heat_opacity,
    label_colors,
)
from scoup.pictures.legends import heat_legend
from scoup.pictures.lettering import captioned

MASK_COLOR = (255, 92, 40)
BOX_COLOR = (80, 220, 255)
POINT_COLOR = (255, 255, 255)
OTHER_COLOR = (255, 205, 0)


def heat_map(
    relevancy: ArrayOrTensor, rgb: ArrayOrTensor, query: str, level: str, score: float | None, view: str = ""
) -> Picture:
    """Draw a relevancy map over the greyed colour render, with a legend and a title: the query on the left; view, level
    and score, if there is one, on the right."""
    values = as_array(relevancy).astype(np.float64)
    span = heat_span(values)
    shown = heat_overlay(values, rgb, span)
    said = "" if score is None else f"score {score:.2f}"
    remark = ", ".join(filter(None, [view, f"level {level}", said]))
    return heat_legend(captioned(shown, query, remark), *span)


def heat_span(relevancy: np.ndarray) -> tuple[float, float]:
    """Return the relevancy at the two ends of the colours: the median of the map, so that at least half of the picture
    stays clear, and its maximum.
    """
    finite = relevancy[np.isfinite(relevancy)]
    return (float(np.median(finite)), float(finite.max())) if len(finite) else (0.0, 1.0)


def heat_overlay(
    relevancy: ArrayOrTensor,
    rgb: ArrayOrTensor,
    span: tuple[float, float] | None = None,
    opacity: float = 1.0,
) -> Picture:
    """Draw a relevancy map over the greyed colour render, without any lettering; low relevancy is see-through. The ends
    of the colours are ``heat_span`` of the map by default; ``opacity`` 0..1 multiplies theirs."""
    values, picture = as_array(relevancy).astype(np.float64), as_picture(rgb)
    _check_size(values, picture, "relevancy")
    low, high = span or heat_span(values)
    amounts = heat_amounts(np.nan_to_num(values, nan=low), (low, high))
    share = opacity * STRONGEST * heat_opacity(amounts)[..., None]
    return (BACKDROP * grey(picture) * (1 - share) + heat_colors(amounts) * share).astype(np.uint8)


def mask_overlay(
    mask: ArrayOrTensor,
    rgb: ArrayOrTensor,
    box: tuple[float, float, float, float] | None = None,
    point: tuple[float, float] | None = None,
    label: str = "",
    remark: str = "",
    color: tuple[int, int, int] = MASK_COLOR,
    other: ArrayOrTensor | None = None,
) -> Picture:
    """Draw a mask over the colour render: tinted, outlined, the rest darker; with a box, a cross and the outline of
    another mask if given. The label is written above, with ``remark`` on the right; there is no strip if both are
    empty."""
    inside, picture = as_array(mask).astype(bool), as_picture(rgb)
    _check_size(inside, picture, "mask")
    shown = np.where(inside[..., None], picture * 0.55 + np.array(color) * 0.45, picture * 0.72)
    drawn = _draw_marks(shown.astype(np.uint8), inside, color, box, point, other)
    return captioned(drawn, label, remark) if label or remark else drawn


def texts_overlay(
    heats: Sequence[ArrayOrTensor],
    masks: Sequence[ArrayOrTensor],
    rgb: ArrayOrTensor,
    colors: Sequence[Sequence[float]],
    opacity: float = 1.0,
    on_grey: bool = False,
) -> Picture:
    """Draw the answers to several texts as the viewer's page does: each in its colour, its mask outlined.

    A pixel has the colour of the text with the largest relevancy, among those whose masks contain it if any does. With
    ``on_grey`` over the greyed render, where what is relevant outside of the masks is tinted faintly.
    """
    picture = as_picture(rgb)
    values = [as_array(heat).astype(np.float64) for heat in heats]
    amounts = np.stack([heat_amounts(np.nan_to_num(heat, nan=-np.inf), heat_span(heat)) for heat in values])
    inside = np.stack([as_array(mask).astype(bool) for mask in masks])
    _check_size(amounts[0], picture, "relevancy")
    any_inside, most = np.any(inside, axis=0), amounts.max(0)
    tint = np.asarray(colors, np.float64)[np.where(inside, 1 + amounts, amounts).argmax(0)]
    if on_grey:
        ground = BACKDROP * grey(picture) * np.ones(3)
        share = opacity * np.where(any_inside, 0.85 + 0.15 * most, 0.5 * most**2)[..., None]
    else:
        ground = np.where(any_inside[..., None], picture, (1 - 0.35 * opacity) * picture)
        share = opacity * np.where(any_inside, 0.9, 0)[..., None]
    shown = (ground * (1 - share) + tint * share).astype(np.uint8)
    for mask, color in zip(inside, colors, strict=True):
        shown = _draw_marks(shown, mask, color)
    return shown


def answer_overlay(
    relevancy: ArrayOrTensor,
    mask: ArrayOrTensor,
    rgb: ArrayOrTensor,
    span: tuple[float, float],
    box: tuple[float, float, float, float] | None = None,
    point: tuple[float, float] | None = None,
    other: ArrayOrTensor | None = None,
) -> Picture:
    """Draw the outlines of the mask and of another, the box and the point over ``heat_overlay``; no lettering."""
    inside, heat = as_array(mask).astype(bool), heat_overlay(relevancy, rgb, span)
    _check_size(inside, heat, "mask")
    return _draw_marks(heat, inside, POINT_COLOR, box, point, other)


def eroded(inside: np.ndarray, width: int) -> np.ndarray:
    """Erode a mask [H, W] ``width`` times across edges; beyond the picture counts as inside."""
    for _ in range(width):
        around = np.pad(inside, 1, constant_values=True)
        rows, columns = around[:, 1:-1], around[1:-1]
        inside = inside & rows[:-2] & rows[2:] & columns[:, :-2] & columns[:, 2:]
    return inside


def _draw_marks(
    picture: Picture,
    inside: np.ndarray,
    color: Sequence[float],
    box: tuple[float, float, float, float] | None = None,
    point: tuple[float, float] | None = None,
    other: ArrayOrTensor | None = None,
) -> Picture:
    """Draw the outlines of a mask, lighter than its colour, and of another, a box and a cross."""
    width = max(1, round(picture.shape[1] / 320))
    shown = picture.copy()
    if other is not None:
        around = as_array(other).astype(bool)
        shown[around & ~eroded(around, width)] = OTHER_COLOR
    shown[inside & ~eroded(inside, width)] = np.minimum(np.array(color) * 0.75 + 64, 255)
    canvas = Image.fromarray(shown)
    draw = ImageDraw.Draw(canvas)
    if box is not None:
        x0, y0, x1, y1 = box
        draw.rectangle((x0, y0, max(x0, x1 - 1), max(y0, y1 - 1)), outline=BOX_COLOR, width=width)
    if point is not None:
        _cross(draw, point, max(3, round(picture.shape[1] / 80)), width)
    return np.asarray(canvas)


def region_overlay(labels: ArrayOrTensor, rgb: ArrayOrTensor) -> Picture:
    """Draw regions, labels [H, W] with -1 for none, in different colours over the greyed render, with dark borders;
    pixels without a region stay grey."""
    numbers, picture = as_array(labels), as_picture(rgb)
    _check_size(numbers, picture, "labels")
    none = numbers < 0
    backdrop = grey(picture) * np.ones(3)
    tint = (
        label_colors(int(numbers.max(initial=-1)) + 1)[np.where(none, 0, numbers)]
        if (~none).any()
        else backdrop
    )
    shade = 0.45 + 0.55 * backdrop / 255  # shapes stay visible inside a region
    shown = np.where(none[..., None], backdrop * 0.5, backdrop * 0.4 + tint * shade * 0.6)
    border = np.zeros(numbers.shape, bool)
    border[:, 1:] |= numbers[:, 1:] != numbers[:, :-1]
    border[1:] |= numbers[1:] != numbers[:-1]
    shown[border] *= 0.35
    return shown.astype(np.uint8)


def _check_size(values: np.ndarray, picture: Picture, what: str) -> None:
    if values.shape != picture.shape[:2]:
        raise InputError(
            f"{what} {list(values.shape)} does not fit an image of {list(picture.shape[:2])} pixels"
        )


def _cross(draw: ImageDraw.ImageDraw, point: tuple[float, float], size: int, width: int) -> None:
    """Draw a cross with a dark rim, so that it shows on any ground."""
    x, y = point
    for color, extra in (((0, 0, 0), 2), (POINT_COLOR, 0)):
        reach = size + extra // 2
        draw.line((x - reach, y, x + reach, y), fill=color, width=width + extra)
        draw.line((x, y - reach, x, y + reach), fill=color, width=width + extra)
