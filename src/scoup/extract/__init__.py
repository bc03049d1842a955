"""From photographs to regions and their embeddings (docs/extract.md), and views of a splat that has no photographs.

The loop takes any segmenter and embedder, and chooses the photographs that matter.
"""

from scoup.extract.concepts import extract_concepts
from scoup.extract.constants import FEW
from scoup.extract.masks import Masks
from scoup.extract.own_views import SHEET, TRANSFORMS, choose_cameras, estimated_up, save_views
from scoup.extract.photograph_choice import choose_photographs, total_wanted
from scoup.extract.photographs import Photograph, find_photographs
from scoup.extract.pipeline import ExtractReport, embed_masks, extract, lacks_views
from scoup.extract.registry import EMBEDDERS, SEGMENTERS, open_embedder, open_pair, open_segmenter
from scoup.extract.settings import MaskSettings, mask_settings

__all__ = [
    "EMBEDDERS",
    "FEW",
    "SEGMENTERS",
    "SHEET",
    "TRANSFORMS",
    "ExtractReport",
    "MaskSettings",
    "Masks",
    "Photograph",
    "choose_cameras",
    "choose_photographs",
    "embed_masks",
    "estimated_up",
    "extract",
    "extract_concepts",
    "find_photographs",
    "lacks_views",
    "mask_settings",
    "open_embedder",
    "open_pair",
    "open_segmenter",
    "save_views",
    "total_wanted",
]
