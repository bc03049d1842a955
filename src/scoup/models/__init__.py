"""Models of embeddings and masks: text encoders, image embedders, SAM, open-vocabulary detectors, word tables.

Only this room knows transformers and open_clip, which are loaded when a model is opened. A model is opened by its name,
and says which text space its embeddings are in.
"""

from scoup.models.concepts import CONCEPTS, ConceptModel, open_concepts
from scoup.models.dense import open_dense_model
from scoup.models.embedders import embedder_table
from scoup.models.entry import ModelEntry
from scoup.models.hub import ModelIdentity
from scoup.models.sam import EncodedImage, PointModel, open_sam, segmenter_table
from scoup.models.text import ARTICLES, LONGEST, Encoder, TextEncoder, check_model, words_problem
from scoup.models.word_table import WordTable
from scoup.models.words import CANONICAL_PHRASES, EVERYDAY_WORDS, LEAST_WORDS, with_everyday

__all__ = [
    "ARTICLES",
    "CANONICAL_PHRASES",
    "CONCEPTS",
    "EVERYDAY_WORDS",
    "LEAST_WORDS",
    "LONGEST",
    "ConceptModel",
    "EncodedImage",
    "Encoder",
    "ModelEntry",
    "ModelIdentity",
    "PointModel",
    "TextEncoder",
    "WordTable",
    "check_model",
    "embedder_table",
    "open_concepts",
    "open_dense_model",
    "open_sam",
    "segmenter_table",
    "with_everyday",
    "words_problem",
]
