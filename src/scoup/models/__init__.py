"""Models of embeddings and masks: text encoders, image embedders, SAM, open-vocabulary detectors, word tables.

Only this room knows transformers and open_clip, which are loaded when a model is opened. A model is opened by its name,
and says which text space its embeddings are in.
"""

from scoup.base import lazy_names
from scoup.models.concepts import CONCEPTS, ConceptModel, open_concepts
from scoup.models.dense import DENSE_PREFIX, DenseModel, open_dense_model
from scoup.models.entry import Device, HubEntry, ModelEntry
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
    everyday_vocabulary,
)
from scoup.models.text_models import ANY_OPEN_CLIP, GROUP, HUB
from scoup.models.word_table import check_table_name, is_table, load_table, save_table
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
    "DenseModel",
    "Device",
    "EncodedImage",
    "Encoder",
    "HubEntry",
    "ModelEntry",
    "ModelIdentity",
    "PointModel",
    "TextEncoder",
    "check_model",
    "check_table_name",
    "everyday_vocabulary",
    "is_table",
    "load_table",
    "open_concepts",
    "open_dense_model",
    "open_image_model",
    "open_sam",
    "save_table",
    "with_everyday",
]

# The list is read when it is needed.
__getattr__ = lazy_names(__name__, {"EVERYDAY_WORDS": "scoup.models.words"})
