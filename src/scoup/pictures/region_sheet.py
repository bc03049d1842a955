"""The regions of a view as a picture."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw

from scoup.base import counted
from scoup.pictures.colors import ArrayOrTensor, Picture, as_array, as_picture
from scoup.pictures.lettering import font, text_width
from scoup.pictures.overlays import region_overlay
from scoup.pictures.sheet import contact_sheet, sheet_tile_width

COLUMNS = 2
RIM = 1  # dark pixels around a number
FONT = 13  # pixels
_NAMES = {"s": "level s (fine)", "m": "level m (medium)", "l": "level l (coarse)"}


def regions_sheet(
    image: ArrayOrTensor,
    labels: ArrayOrTensor,
    levels: Sequence[str],
    name: str = "",
    remark: str = "",
    width: int = 1800,
) -> Picture:
    """Return the photograph and its regions [S, H, W] (-1 for none) at each level, two and two, with the number of each
    region that has room; the name of the view is written above, the remark below."""
    photograph = as_picture(image)
    # At the size of the tiles, so that the numbers are not reduced with them.
    tile_width = sheet_tile_width(width, COLUMNS)
    size = (tile_width, max(1, round(photograph.shape[0] * tile_width / photograph.shape[1])))
    base = np.asarray(Image.fromarray(photograph).resize(size, Image.Resampling.LANCZOS))
    tiles, captions = [base], ["photograph"]
    for plane, level in zip(as_array(labels), levels, strict=True):
        shown = np.asarray(Image.fromarray(plane.astype(np.int32)).resize(size, Image.Resampling.NEAREST))
        tile, written = numbered(region_overlay(shown, base), shown)
        tiles.append(tile)
        count = len(np.unique(plane[plane >= 0]))
        captions.append(f"{_NAMES.get(level, level)}: {counted(count, 'region')}{_which(written, count)}")
    return contact_sheet(tiles, captions, COLUMNS, width, heading=name, footer=remark)


def _which(written: int, count: int) -> str:
    if written == count:
        return ""
    return f", numbers on the {written} with room" if written else ", no room for numbers"


def numbered(picture: Picture, labels: np.ndarray) -> tuple[Picture, int]:
    """Return the picture with the number of each region (labels [H, W], -1 for none) that has room for it, where the
    region is thickest; and how many were written.

    A number is written only where it lies inside its own region as a whole, so that no two can touch.
    """
    from scipy import ndimage

    canvas = Image.fromarray(picture)
    draw = ImageDraw.Draw(canvas)
    face, written = font(FONT), 0
    for number, box in enumerate(ndimage.find_objects(labels + 1)):
        if box is None:
            continue
        inside = np.pad(labels[box] == number, 1)
        text = str(number)
        needed = (FONT + 2 * RIM, text_width(text, face) + 2 * RIM)  # pixels down and across
        room = ndimage.minimum_filter(inside.astype(np.uint8), needed, mode="constant")
        if not room.any():
            continue
        depth = np.asarray(ndimage.distance_transform_cdt(inside)) * room
        row, column = np.unravel_index(int(depth.argmax()), depth.shape)
        x, y = box[1].start + int(column) - 0.5, box[0].start + int(row) - 0.5
        draw.text((x, y), text, (255, 255, 255), face, anchor="mm", stroke_width=RIM, stroke_fill=(0, 0, 0))
        written += 1
    return np.asarray(canvas), written
