"""Answers drawn over the colour render: heat maps, masks, regions."""

from __future__ import annotations

import numpy as np
from PIL import Image, ImageDraw
from scipy import ndimage

from scoup.base.errors import InputError
from scoup.pictures.colors import (
    ArrayOrTensor,
    Picture,
    as_array,
    as_picture,
    grey,
    heat_colors,
    label_colors,
)
from scoup.pictures.lettering import FAINT, INK, LEAST_WIDTH, PAPER, captioned, font, strip_height, text_width

MASK_COLOR = (255, 92, 40)
BOX_COLOR = (80, 220, 255)
POINT_COLOR = (255, 255, 255)
BACKDROP = 0.62  # brightness of the grey render under a heat map
STRONGEST = 0.92  # opacity of the heat where relevancy is highest


def heat_map(
    relevancy: ArrayOrTensor,
    rgb: ArrayOrTensor,
    query: str = "",
    level: str = "",
    score: float | None = None,
    span: tuple[float, float] | None = None,
) -> Picture:
    """A relevancy map over the greyed colour render. Low relevancy is see-through; a legend gives the
    numbers.

    Args:
        relevancy: [H, W].
        rgb: [H, W, 3] float 0..1 or uint8.
        query: its text, written above; no strip if there is neither text, level nor score.
        level: the level shown, for example "m".
        score: written beside the level.
        span: relevancy at the two ends of the colours; by default from the median of the map (at least half
            of the picture stays clear) to its maximum.

    Returns:
        [H + two strips, max(W, 120), 3] uint8.

    Raises:
        InputError: sizes disagree.
    """
    values, picture = as_array(relevancy).astype(np.float64), as_picture(rgb)
    _check_size(values, picture, "relevancy")
    finite = values[np.isfinite(values)]
    low, high = span or ((float(np.median(finite)), float(finite.max())) if len(finite) else (0.0, 1.0))
    amounts = (
        (np.nan_to_num(values, nan=low) - low) / (high - low) if high - low > 1e-6 else np.zeros_like(values)
    )
    amounts = amounts.clip(0, 1)
    opacity = STRONGEST * _presence(amounts)[..., None]
    shown = BACKDROP * grey(picture) * (1 - opacity) + heat_colors(amounts) * opacity
    remark = ", ".join(part for part in (f"level {level}" if level else "", _number(score)) if part)
    drawn = shown.astype(np.uint8)
    titled = captioned(drawn, query or "relevancy", remark) if query or remark else drawn
    legend = _legend(titled.shape[1], low, high)
    if legend.shape[1] > titled.shape[1]:
        margin = legend.shape[1] - titled.shape[1]
        sides = ((0, 0), (margin // 2, margin - margin // 2), (0, 0))
        titled = np.pad(titled, sides)
    return np.concatenate([titled, legend])


def mask_overlay(
    mask: ArrayOrTensor,
    rgb: ArrayOrTensor,
    box: tuple[float, float, float, float] | None = None,
    point: tuple[float, float] | None = None,
    label: str = "",
    remark: str = "",
    color: tuple[int, int, int] = MASK_COLOR,
) -> Picture:
    """A mask over the colour render: tinted, outlined, the rest darker; with a box and a cross if given.

    Args:
        mask: [H, W] bool.
        rgb: [H, W, 3] float 0..1 or uint8.
        box: (x0, y0, x1, y1) in pixels, x1 and y1 one past the last.
        point: (x, y) pixel marked with a cross.
        label: written above, with ``remark`` on the right; no strip if both are empty.
        color: of the mask.

    Returns:
        [H (+ strip), W, 3] uint8.

    Raises:
        InputError: sizes disagree.
    """
    inside, picture = as_array(mask).astype(bool), as_picture(rgb)
    _check_size(inside, picture, "mask")
    shown = np.where(inside[..., None], picture * 0.55 + np.array(color) * 0.45, picture * 0.72)
    width = max(1, round(picture.shape[1] / 320))
    core = np.asarray(ndimage.binary_erosion(inside, iterations=width, border_value=1), bool)
    rim = inside & ~core
    shown[rim] = np.minimum(np.array(color) * 0.75 + 64, 255)
    canvas = Image.fromarray(shown.astype(np.uint8))
    draw = ImageDraw.Draw(canvas)
    if box is not None:
        x0, y0, x1, y1 = box
        draw.rectangle((x0, y0, max(x0, x1 - 1), max(y0, y1 - 1)), outline=BOX_COLOR, width=width)
    if point is not None:
        _cross(draw, point, max(3, round(picture.shape[1] / 80)), width)
    drawn = np.asarray(canvas)
    return captioned(drawn, label, remark) if label or remark else drawn


def region_overlay(labels: ArrayOrTensor, rgb: ArrayOrTensor, opacity: float = 0.6) -> Picture:
    """Regions in different colours over the greyed render, with dark borders; pixels without a region stay
    grey.

    Args:
        labels: [H, W] integers, -1 for no region.
        rgb: [H, W, 3] float 0..1 or uint8.
        opacity: of the colours.

    Raises:
        InputError: sizes disagree.
    """
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
    shown = np.where(none[..., None], backdrop * 0.5, backdrop * (1 - opacity) + tint * shade * opacity)
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


def _presence(amounts: np.ndarray) -> np.ndarray:
    """How much of the heat shows, 0..1: none at the low end, so that the picture stays clear there."""
    share = ((amounts - 0.08) / 0.5).clip(0, 1)
    return share * share * (3 - 2 * share)


def _number(score: float | None) -> str:
    return "" if score is None else f"{score:.3f}"


def _legend(width: int, low: float, high: float) -> Picture:
    """[strip, width, 3]: the colours, with the relevancy at both ends and, where there is room, in the
    middle.
    """
    width = max(width, LEAST_WIDTH)
    height = strip_height(width)
    canvas = Image.new("RGB", (width, height), PAPER)
    face = font(max(9, height * 0.48))
    left, right = f"{low:.2f}", f"{high:.2f}"
    margin = max(3, height // 4)
    start, end = 2 * margin + text_width(left, face), width - 2 * margin - text_width(right, face)
    draw = ImageDraw.Draw(canvas)
    draw.text((margin, height / 2), left, INK, face, anchor="lm")
    draw.text((width - margin, height / 2), right, INK, face, anchor="rm")
    if end - start > 8:
        amounts = np.linspace(0, 1, end - start)
        opacity = _presence(amounts)[:, None]  # as in the map, over mid grey
        bar = (heat_colors(amounts) * opacity + 255 * BACKDROP * 0.5 * (1 - opacity)).astype(np.uint8)
        inset = height // 4
        canvas.paste(
            Image.fromarray(np.broadcast_to(bar, (height - 2 * inset, *bar.shape)).copy()), (start, inset)
        )
        draw.rectangle((start - 1, inset - 1, end, height - inset), outline=FAINT)
    return np.asarray(canvas)


def _cross(draw: ImageDraw.ImageDraw, point: tuple[float, float], size: int, width: int) -> None:
    """A cross with a dark rim, so that it shows on any ground."""
    x, y = point
    for color, extra in (((0, 0, 0), 2), (POINT_COLOR, 0)):
        reach = size + extra // 2
        draw.line((x - reach, y, x + reach, y), fill=color, width=width + extra)
        draw.line((x, y - reach, x, y + reach), fill=color, width=width + extra)
