"""Text on pictures, always inside them, in the font that comes with Pillow.

It has hardly more than ASCII. Accents are dropped, and a box is drawn for each other letter that it lacks.
"""

from __future__ import annotations

import unicodedata
from functools import lru_cache

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from scoup.pictures.colors import Picture, as_picture

INK, PAPER, FAINT = (245, 245, 245), (24, 26, 30), (168, 172, 180)
LEAST_WIDTH = 120  # pixels: narrower pictures get margins, so that their text has room
MOST_LINES = 3  # of a text; what is longer ends in dots

Font = ImageFont.FreeTypeFont | ImageFont.ImageFont


@lru_cache(256)
def font(size: float) -> Font:
    return ImageFont.load_default(size)


def text_width(text: str, face: Font) -> int:
    return int(face.getlength(text) + 0.999)


def lines_of(text: str, width: int, size: float, most: int = MOST_LINES) -> tuple[list[str], Font]:
    """Return the text in at most ``most`` lines of ``width`` pixels, broken between words where it can be, and its
    font."""
    text, face = writable(text), font(size)
    lines: list[str] = []
    while text and len(lines) < most - 1:
        line = _beginning(text, width, face)
        lines.append(line.rstrip())
        text = text[len(line) :].lstrip()
    return [*lines, _shortened(text, width, face)] if text else lines, face


def _beginning(text: str, width: int, face: Font) -> str:
    """Return the longest beginning of the text that fits one line, at least one letter."""
    if text_width(text, face) <= width:
        return text
    end = 1
    while end < len(text) and text_width(text[: end + 1], face) <= width:
        end += 1
    between_words = text.rfind(" ", 0, end + 1)
    return text[: between_words + 1] if between_words > 0 else text[:end]


def _shortened(text: str, width: int, face: Font) -> str:
    if text_width(text, face) <= width:
        return text
    while text and text_width(text + "...", face) > width:
        text = text[:-1]
    return text.rstrip() + "..." if text else ""


def writable(text: str) -> str:
    """Return the text in one line, without accents."""
    letters = unicodedata.normalize("NFD", " ".join(text.split()))
    return "".join(letter for letter in letters if not unicodedata.combining(letter))


def strip_height(width: int) -> int:
    """Return the height of a line of text under or over a picture of this width."""
    return max(22, min(40, round(width * 0.06)))


def fits_one_line(width: int, text: str, right: str = "") -> bool:
    """Return whether both texts of a ``caption`` fit beside each other."""
    height = strip_height(width)
    margin, size = max(3, height // 4), height * 0.6
    texts = [text_width(writable(text), font(size)), text_width(writable(right), font(size * 0.85))]
    return sum(texts) + (4 if all(texts) else 2) * margin <= width


def caption(width: int, text: str, right: str = "", one_line: bool | None = None) -> Picture:
    """Draw a dark strip with ``text`` on the left and ``right``, a fainter remark, on the right; or below each other if
    they do not fit ``one_line``. Of more than three lines the end is left out."""
    height = strip_height(width)
    margin, size = max(3, height // 4), height * 0.6
    room = width - 2 * margin
    if fits_one_line(width, text, right) if one_line is None else one_line:
        canvas = Image.new("RGB", (width, height), PAPER)
        _write(canvas, (margin, height / 2), *lines_of(text, room, size, 1), INK)
        _write(canvas, (width - margin, height / 2), *lines_of(right, room, size * 0.85, 1), FAINT, "rm")
        return np.asarray(canvas)
    smaller = max(11.0, size * 0.8)
    parts = [(*lines_of(text, room, smaller), INK), (*lines_of(right, room, smaller * 0.9), FAINT)]
    step = round(smaller * 1.4)
    count = sum(len(lines) for lines, _, _ in parts)
    canvas = Image.new("RGB", (width, step * count + margin), PAPER)
    y = margin / 2 + step / 2
    for lines, face, ink in parts:
        _write(canvas, (margin, y), lines, face, ink, "lm", step)
        y += step * len(lines)
    return np.asarray(canvas)


def _write(
    canvas: Image.Image,
    at: tuple[float, float],
    lines: list[str],
    face: Font,
    ink: tuple[int, int, int],
    anchor: str = "lm",
    step: int = 0,
) -> None:
    draw = ImageDraw.Draw(canvas)
    for number, line in enumerate(lines):
        draw.text((at[0], at[1] + number * step), line, ink, face, anchor=anchor)


def captioned(image: Picture, text: str, right: str = "") -> Picture:
    """Put a dark strip above the picture: what it shows, and a remark such as the score (see ``caption``)."""
    picture = as_picture(image)
    width = max(picture.shape[1], LEAST_WIDTH)
    return stacked([caption(width, text, right), picture])


def stacked(parts: list[Picture]) -> Picture:
    """Stack pictures below each other, narrower ones in the middle between dark margins."""
    width = max(picture.shape[1] for picture in parts)
    canvas = np.full((sum(picture.shape[0] for picture in parts), width, 3), PAPER, np.uint8)
    y = 0
    for picture in parts:
        x = (width - picture.shape[1]) // 2
        canvas[y : y + picture.shape[0], x : x + picture.shape[1]] = picture
        y += picture.shape[0]
    return canvas
