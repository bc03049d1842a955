"""Pictures of answers, drawn with Pillow alone. All functions take arrays or tensors and give [H, W, 3]
uint8.
"""

from scoup.pictures.colors import as_picture, code_basis, code_picture, heat_colors, label_colors
from scoup.pictures.legends import heat_legend, swatch_legend
from scoup.pictures.lettering import captioned, stacked
from scoup.pictures.overlays import answer_overlay, heat_map, heat_overlay, mask_overlay, region_overlay
from scoup.pictures.region_sheet import regions_sheet
from scoup.pictures.sheet import contact_sheet

__all__ = [
    "answer_overlay",
    "as_picture",
    "captioned",
    "code_basis",
    "code_picture",
    "contact_sheet",
    "heat_colors",
    "heat_legend",
    "heat_map",
    "heat_overlay",
    "label_colors",
    "mask_overlay",
    "region_overlay",
    "regions_sheet",
    "stacked",
    "swatch_legend",
]
