"""Models of embeddings and masks: text encoders, image embedders, SAM, open-vocabulary detectors, word tables.

Only this room knows transformers and open_clip, which are loaded when a model is opened. A model is opened by its name,
and says which text space its embeddings are in.
"""

from scoup.base import lazy_names
from scoup.models.concepts import CONCEPTS, ConceptModel, open_concepts
from scoup.models.dense import DENSE_PREFIX, open_dense_model
from scoup.models.entry import HubEntry, ModelEntry
from scoup.models.hub import OPEN_CLIP, ModelIdentity
from scoup.models.image import open_image_model
from scoup.models.mobile_sam import MOBILE_SAM_FILE
from scoup.models.sam import MOBILE_SAM, EncodedImage, PointModel, open_sam
from scoup.models.text import (
    ARTICLES,
    COLORS,
    LONGEST,
    NO_WORDS_FOR_COLORS,
    Encoder,
    TextEncoder,
    check_model,
)
from scoup.models.text_models import ANY_OPEN_CLIP, GROUP, HUB
from scoup.models.word_table import WordTable
from scoup.models.words import CANONICAL_PHRASES, LEAST_WORDS, with_everyday

__all__ = [
    "ANY_OPEN_CLIP",
    "ARTICLES",
    "CANONICAL_PHRASES",
    "COLORS",
    "CONCEPTS",
    "DENSE_PREFIX",
    "EVERYDAY_WORDS",  # pyright: ignore[reportUnsupportedDunderAll]
    "GROUP",
    "HUB",
    "LEAST_WORDS",
    "LONGEST",
    "MOBILE_SAM",
    "MOBILE_SAM_FILE",
    "NO_WORDS_FOR_COLORS",
    "OPEN_CLIP",
    "ConceptModel",
    "EncodedImage",
    "Encoder",
    "HubEntry",
    "ModelEntry",
    "ModelIdentity",
    "PointModel",
    "TextEncoder",
    "WordTable",
    "check_model",
    "open_concepts",
    "open_dense_model",
    "open_image_model",
    "open_sam",
    "with_everyday",
]

# The list is read when it is needed.
__getattr__ = lazy_names(__name__, {"EVERYDAY_WORDS": "scoup.models.words"})
