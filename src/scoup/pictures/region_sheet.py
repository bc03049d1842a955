"""The regions of a view as a picture."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw

from scoup.pictures.colors import ArrayOrTensor, Picture, as_array, as_picture
from scoup.pictures.lettering import font, text_width
from scoup.pictures.overlays import region_overlay
from scoup.pictures.sheet import contact_sheet

_NAMES = {"s": "small (s)", "m": "medium (m)", "l": "large (l)"}


def regions_sheet(
    image: ArrayOrTensor,
    labels: ArrayOrTensor,
    levels: Sequence[str],
    name: str = "",
    remark: str = "",
    width: int = 1800,
) -> Picture:
    """The photograph and its regions at each level, two and two, with the number of each region that has room.

    Args:
        image: [H, W, 3].
        labels: [S, H, W] region numbers, -1 for none.
        levels: S level names.
        name: of the view, written above.
        remark: written below.
        width: of the picture in pixels.
    """
    photograph = as_picture(image)
    tiles, captions = [photograph], ["photograph"]
    scale = max(1.0, width / 2 / photograph.shape[1])
    size = (round(photograph.shape[1] * scale), round(photograph.shape[0] * scale))
    base = np.asarray(Image.fromarray(photograph).resize(size, Image.Resampling.BICUBIC))
    for plane, level in zip(as_array(labels), levels, strict=True):
        large = np.asarray(Image.fromarray(plane.astype(np.int32)).resize(size, Image.Resampling.NEAREST))
        tiles.append(numbered(region_overlay(large, base), large))
        count = len(np.unique(plane[plane >= 0]))
        captions.append(f"{_NAMES.get(level, level)}: {count} regions")
    return contact_sheet(tiles, captions, columns=2, width=width, heading=name, footer=remark)


def numbered(picture: Picture, labels: np.ndarray, size: int = 12) -> Picture:
    """The picture with the number of each region written where the region is thickest, if it fits there."""
    from scipy import ndimage

    canvas = Image.fromarray(picture)
    draw = ImageDraw.Draw(canvas)
    face = font(size)
    for number, place in enumerate(ndimage.find_objects(labels + 1)):
        if place is None:
            continue
        inside = np.pad(labels[place] == number, 1)
        depth = np.asarray(ndimage.distance_transform_cdt(inside))
        row, column = np.unravel_index(int(depth.argmax()), depth.shape)
        text = str(number)
        if depth[row, column] < max(text_width(text, face), size) / 2:
            continue
        x, y = place[1].start + int(column) - 0.5, place[0].start + int(row) - 0.5
        draw.text((x, y), text, (255, 255, 255), face, anchor="mm", stroke_width=1, stroke_fill=(0, 0, 0))
    return np.asarray(canvas)
