"""From photographs to regions and their embeddings (docs/extract.md), and views of a splat that has no photographs.

The loop takes any segmenter and embedder, and chooses the photographs that matter.
"""

from scoup.extract.concepts import extract_concepts
from scoup.extract.mask_report import report_masks
from scoup.extract.masks import Masks
from scoup.extract.own_views import SHEET, TRANSFORMS, choose_cameras, save_views, write_own_views
from scoup.extract.photograph_choice import PhotographChoice
from scoup.extract.photographs import Photograph, find_photographs
from scoup.extract.pipeline import ExtractReport, crops_minutes, embed_image, extract, lacks_views
from scoup.extract.registry import model_tables, open_embedder, open_pair, open_segmenter
from scoup.extract.settings import mask_settings

__all__ = [
    "SHEET",
    "TRANSFORMS",
    "ExtractReport",
    "Masks",
    "Photograph",
    "PhotographChoice",
    "choose_cameras",
    "crops_minutes",
    "embed_image",
    "extract",
    "extract_concepts",
    "find_photographs",
    "lacks_views",
    "mask_settings",
    "model_tables",
    "open_embedder",
    "open_pair",
    "open_segmenter",
    "report_masks",
    "save_views",
    "write_own_views",
]
