"""Text on pictures, always inside them."""

from __future__ import annotations

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from scoup.pictures.colors import Picture, as_picture

INK, PAPER, FAINT = (245, 245, 245), (24, 26, 30), (168, 172, 180)
SMALLEST_FONT = 9
LEAST_WIDTH = 120  # pixels: narrower pictures get margins, so that their text has room

Font = ImageFont.FreeTypeFont | ImageFont.ImageFont


def font(size: float) -> Font:
    """Pillow's own font; needs no file."""
    return ImageFont.load_default(size=size)


def text_width(text: str, face: Font) -> int:
    """Pixels."""
    return int(face.getlength(text) + 0.999)


def fitted(text: str, width: int, size: float) -> tuple[str, Font]:
    """The text and a font such that it is at most ``width`` pixels wide: smaller first, then shortened with
    dots.
    """
    while size > SMALLEST_FONT and text_width(text, font(size)) > width:
        size -= 1
    face = font(size)
    if text_width(text, face) <= width:
        return text, face
    while text and text_width(text + "...", face) > width:
        text = text[:-1]
    return text.rstrip() + "..." if text else "", face


def strip_height(width: int) -> int:
    """Height of a line of text under or over a picture of this width."""
    return max(22, min(40, round(width * 0.06)))


def captioned(image: Picture, text: str, right: str = "") -> Picture:
    """The picture with a dark strip above it: ``text`` on the left and ``right``, fainter, on the right.

    Args:
        image: [H, W, 3].
        text: what it shows.
        right: a remark such as the score; shortened before ``text`` is.

    Returns:
        [H + strip, max(W, 120), 3] uint8.
    """
    picture = as_picture(image)
    width = max(picture.shape[1], LEAST_WIDTH)
    height = strip_height(width)
    canvas = Image.new("RGB", (width, height + picture.shape[0]), PAPER)
    canvas.paste(Image.fromarray(picture), ((width - picture.shape[1]) // 2, height))
    write_line(canvas, (0, 0, width, height), text, right)
    return np.asarray(canvas)


def write_line(canvas: Image.Image, box: tuple[int, int, int, int], text: str, right: str = "") -> None:
    """Write a line into a box (x0, y0, x1, y1) of the canvas, vertically centred."""
    draw = ImageDraw.Draw(canvas)
    x0, y0, x1, y1 = box
    height = y1 - y0
    margin, size = max(3, height // 4), height * 0.6
    room = x1 - x0 - 2 * margin
    middle = (y0 + y1) / 2
    text, face = fitted(text, room, size)
    draw.text((x0 + margin, middle), text, INK, face, anchor="lm")
    left = room - text_width(text, face) - 2 * margin if text else room
    if right and left > 3 * size:
        right, face = fitted(right, left, size * 0.85)
        draw.text((x1 - margin, middle), right, FAINT, face, anchor="rm")
