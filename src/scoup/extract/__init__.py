"""From photographs to region maps and embeddings (docs/extract.md).

The only place that knows SAM and CLIP image models. ``extract`` is a loop over photographs that takes any segmenter
and any embedder; ``open_segmenter`` and ``open_embedder`` find those by name.
"""

from scoup.extract.masks import Masks, paint
from scoup.extract.opening import open_embedder, open_segmenter
from scoup.extract.parts import Embedder, Segmenter
from scoup.extract.photographs import Photograph, find_photographs
from scoup.extract.pipeline import ExtractReport, extract
from scoup.extract.settings import MaskSettings, mask_settings

__all__ = [
    "Embedder",
    "ExtractReport",
    "MaskSettings",
    "Masks",
    "Photograph",
    "Segmenter",
    "extract",
    "find_photographs",
    "mask_settings",
    "open_embedder",
    "open_segmenter",
    "paint",
]
