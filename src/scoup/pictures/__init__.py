"""Pictures of answers, drawn with Pillow alone. All functions take arrays or tensors and give [H, W, 3]
uint8.
"""

from scoup.pictures.colors import as_picture, code_basis, code_picture, heat_colors, label_colors
from scoup.pictures.lettering import captioned
from scoup.pictures.overlays import heat_map, mask_overlay, region_overlay
from scoup.pictures.region_sheet import regions_sheet
from scoup.pictures.sheet import contact_sheet

__all__ = [
    "as_picture",
    "captioned",
    "code_basis",
    "code_picture",
    "contact_sheet",
    "heat_colors",
    "heat_map",
    "label_colors",
    "mask_overlay",
    "region_overlay",
    "regions_sheet",
]
