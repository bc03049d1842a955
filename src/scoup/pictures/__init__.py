"""Pictures of answers, drawn with Pillow alone: heat maps, masks, sheets, animations.

All functions take arrays or tensors and return [H, W, 3] uint8.
"""

from scoup.pictures.colors import Picture, as_picture, code_basis, code_picture, label_colors
from scoup.pictures.legends import heat_legend, swatch_legend
from scoup.pictures.lettering import captioned
from scoup.pictures.overlays import (
    answer_overlay,
    heat_map,
    heat_overlay,
    mask_overlay,
    region_overlay,
    texts_overlay,
)
from scoup.pictures.region_sheet import regions_sheet
from scoup.pictures.sheet import contact_sheet, sheet_tile
from scoup.pictures.video import check_video_writer, save_frames

__all__ = [
    "Picture",
    "answer_overlay",
    "as_picture",
    "captioned",
    "check_video_writer",
    "code_basis",
    "code_picture",
    "contact_sheet",
    "heat_legend",
    "heat_map",
    "heat_overlay",
    "label_colors",
    "mask_overlay",
    "region_overlay",
    "regions_sheet",
    "save_frames",
    "sheet_tile",
    "swatch_legend",
    "texts_overlay",
]
