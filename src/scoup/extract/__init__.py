"""From photographs to region maps and embeddings (docs/extract.md): a loop that takes any segmenter and embedder."""

from scoup.extract.interfaces import Embedder, Segmenter
from scoup.extract.masks import Masks, paint
from scoup.extract.photograph_choice import choose_photographs
from scoup.extract.photographs import Photograph, find_photographs
from scoup.extract.pipeline import ExtractReport, extract
from scoup.extract.registry import open_embedder, open_segmenter
from scoup.extract.settings import MaskSettings, mask_settings

__all__ = [
    "Embedder",
    "ExtractReport",
    "MaskSettings",
    "Masks",
    "Photograph",
    "Segmenter",
    "choose_photographs",
    "extract",
    "find_photographs",
    "mask_settings",
    "open_embedder",
    "open_segmenter",
    "paint",
]
