"""Many pictures on one sheet."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw

from scoup.pictures.colors import ArrayOrTensor, Picture, as_picture
from scoup.pictures.lettering import FAINT, LEAST_WIDTH, PAPER, caption, fits_one_line, lines_of

GAP = 8  # pixels between tiles
FOOTER_FONT = 14


def contact_sheet(
    tiles: Sequence[ArrayOrTensor],
    titles: Sequence[str] = (),
    columns: int = 4,
    width: int = 1200,
    heading: str = "",
    footer: str = "",
    remarks: Sequence[str] = (),
    tile_width: int | None = None,
) -> Picture:
    """Return pictures [H, W, 3] of any sizes in rows, each under its title, scaled to fit.

    Args:
        titles: one a tile, or none at all.
        columns: tiles in a row.
        width: of the sheet, in pixels; 1200 suits a README. Or ``tile_width``, of each of ``columns`` tiles.
        heading: a line above all.
        footer: a fainter text below all, broken into lines.
        remarks: written on the right of the titles, one a tile, or none at all.
    """
    if tile_width is not None:
        width = columns * (tile_width + GAP) + GAP
    columns = min(columns, len(tiles))
    tile_width = sheet_tile_width(width, columns)
    shown = [_scaled(as_picture(tile), tile_width) for tile in tiles]
    if titles or remarks:
        shown = _titled(shown, titles or [""] * len(tiles), remarks or [""] * len(tiles), columns)
    parts = [caption(width, heading)] if heading else []
    parts += [_row(shown[start : start + columns], width) for start in range(0, len(shown), columns)]
    return np.concatenate([*parts, _footer(footer, width)])


def sheet_tile_width(width: int, columns: int) -> int:
    """Return the width of a tile, in pixels, on a sheet of this width."""
    return (width - GAP * (columns + 1)) // columns


def sheet_tile(picture: Picture, tiles: int, columns: int = 4, width: int = 1200) -> Picture:
    """Return a picture scaled to a tile of a sheet, so that many take little memory."""
    return _scaled(picture, sheet_tile_width(width, min(columns, tiles)))


def _titled(
    tiles: list[Picture], titles: Sequence[str], remarks: Sequence[str], columns: int
) -> list[Picture]:
    """Return tiles under their titles, in one layout; titles of a row take the same height, so that the pictures are
    aligned."""
    width = tiles[0].shape[1]
    texts = list(zip(titles, remarks, strict=True))
    one_line = all(fits_one_line(max(width, LEAST_WIDTH), *both) for both in texts)
    strips = [_scaled(caption(max(width, LEAST_WIDTH), *both, one_line), width) for both in texts]
    heights = [
        max(strip.shape[0] for strip in strips[start : start + columns])
        for start in range(0, len(strips), columns)
    ]
    return [
        np.concatenate([_on_paper(strip, heights[number // columns]), tile])
        for number, (strip, tile) in enumerate(zip(strips, tiles, strict=True))
    ]


def _on_paper(picture: Picture, height: int) -> Picture:
    below = ((0, height - picture.shape[0]), (0, 0))
    return np.stack([np.pad(picture[..., c], below, constant_values=PAPER[c]) for c in range(3)], axis=-1)


def _row(tiles: list[Picture], width: int) -> Picture:
    height = max(tile.shape[0] for tile in tiles)
    row = np.full((GAP + height, width, 3), PAPER, np.uint8)
    for column, tile in enumerate(tiles):
        x = GAP + column * (tile.shape[1] + GAP)
        row[GAP : GAP + tile.shape[0], x : x + tile.shape[1]] = tile
    return row


def _footer(text: str, width: int) -> Picture:
    """Return the text in lines, or only a margin."""
    lines, face = lines_of(text, width - 2 * GAP, FOOTER_FONT, 12)
    canvas = Image.new("RGB", (width, GAP + 20 * len(lines) + (GAP if lines else 0)), PAPER)
    for number, line in enumerate(lines):
        ImageDraw.Draw(canvas).text((GAP, GAP + 20 * number), line, FAINT, face)
    return np.asarray(canvas)


def _scaled(picture: Picture, width: int) -> Picture:
    height = max(1, round(picture.shape[0] * width / picture.shape[1]))
    if picture.shape[:2] == (height, width):
        return picture
    smaller = width < picture.shape[1]
    how = Image.Resampling.LANCZOS if smaller else Image.Resampling.BICUBIC
    return np.asarray(Image.fromarray(picture).resize((width, height), how))
