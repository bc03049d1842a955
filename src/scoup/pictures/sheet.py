"""Many pictures on one sheet."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw

from scoup.base.errors import InputError
from scoup.pictures.colors import ArrayOrTensor, Picture, as_picture
from scoup.pictures.lettering import FAINT, PAPER, captioned, fitted, font, write_line

GAP = 8  # pixels between tiles


def contact_sheet(
    tiles: Sequence[ArrayOrTensor],
    titles: Sequence[str] = (),
    columns: int = 4,
    width: int = 1200,
    heading: str = "",
    footer: str = "",
    remarks: Sequence[str] = (),
) -> Picture:
    """Pictures in rows, each under its title, scaled to fit.

    Args:
        tiles: each [H, W, 3], float 0..1 or uint8; sizes may differ, proportions are kept.
        titles: one a tile, or none at all.
        columns: tiles in a row.
        width: of the sheet, in pixels; 1200 suits a README.
        heading: a line above all.
        footer: a fainter text below all, broken into lines.
        remarks: written on the right of the titles, one a tile, or none at all.

    Returns:
        [height, width, 3] uint8.

    Raises:
        InputError: no tiles, or titles or remarks that do not fit their number.
    """
    if not tiles or columns < 1:
        raise InputError("a contact sheet needs at least one tile and one column")
    for what, texts in (("titles", titles), ("remarks", remarks)):
        if texts and len(texts) != len(tiles):
            raise InputError(f"{len(texts)} {what} do not fit {len(tiles)} tiles")
    columns = min(columns, len(tiles))
    tile_width = (width - GAP * (columns + 1)) // columns
    if tile_width < 16:
        raise InputError(f"{columns} columns do not fit a sheet {width} pixels wide")
    shown = [_scaled(as_picture(tile), tile_width) for tile in tiles]
    if titles or remarks:
        names, notes = titles or [""] * len(tiles), remarks or [""] * len(tiles)
        shown = [
            _scaled(captioned(tile, name, note), tile_width)
            for tile, name, note in zip(shown, names, notes, strict=True)
        ]
    rows = [shown[start : start + columns] for start in range(0, len(shown), columns)]
    heights = [max(tile.shape[0] for tile in row) for row in rows]
    top = GAP + (44 if heading else 0)
    lines = _broken(footer, width - 2 * GAP) if footer else []
    total = top + sum(heights) + GAP * len(rows) + 20 * len(lines) + (GAP if lines else 0)
    canvas = Image.new("RGB", (width, total), PAPER)
    if heading:
        write_line(canvas, (0, GAP // 2, width, 44), heading)
    y = top
    for row, height in zip(rows, heights, strict=True):
        for column, tile in enumerate(row):
            canvas.paste(Image.fromarray(tile), (GAP + column * (tile_width + GAP), y))
        y += height + GAP
    draw = ImageDraw.Draw(canvas)
    for number, line in enumerate(lines):
        draw.text((GAP, y + 20 * number), line, FAINT, font(14))
    return np.asarray(canvas)


def _scaled(picture: Picture, width: int) -> Picture:
    height = max(1, round(picture.shape[0] * width / picture.shape[1]))
    if picture.shape[:2] == (height, width):
        return picture
    smaller = width < picture.shape[1]
    how = Image.Resampling.LANCZOS if smaller else Image.Resampling.BICUBIC
    return np.asarray(Image.fromarray(picture).resize((width, height), how))


def _broken(text: str, width: int) -> list[str]:
    """The text in lines of at most ``width`` pixels, broken between words."""
    lines: list[str] = []
    for paragraph in text.splitlines():
        line = ""
        for word in paragraph.split():
            longer = f"{line} {word}".strip()
            if line and font(14).getlength(longer) > width:
                lines.append(fitted(line, width, 14)[0])
                longer = word
            line = longer
        lines.append(fitted(line, width, 14)[0])
    return lines
