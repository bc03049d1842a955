"""Vectors of texts, and of what they are compared with."""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from scoup.base.arguments import check_arguments
from scoup.base.brief import brief
from scoup.base.counts import counted
from scoup.base.errors import InputError, ScoupWarning, UnknownNameError
from scoup.models.text import COLORS, NO_WORDS_FOR_COLORS, TextEncoder
from scoup.models.words import CANONICAL_PHRASES, LEAST_WORDS, with_everyday
from scoup.query.coded_scene import CodedScene

# Words that do not tell models apart.
_PUBLISHERS = {"open", "clip", "laion", "openai", "google", "hf", "hub"}


@dataclass(frozen=True, eq=False)
class TextVectors:
    """Queries, and the vectors that they are compared with; all of unit norm and from one encoder."""

    texts: tuple[str, ...]  # Q queries
    queries: Tensor  # [Q, D], of the texts
    canonical: Tensor  # [P, D] of the canonical phrases
    everyday: Tensor  # [B, D] of everyday words
    source: str = ""  # the table or model they are from

    __repr__ = brief

    def of(self, texts: Sequence[str]) -> Tensor:
        """Return the vectors of some of the texts, [len(texts), D]."""
        return torch.stack([self.queries[self.texts.index(text)] for text in texts])

    @property
    def can_judge_presence(self) -> bool:
        """Return whether there are enough everyday words for a z-score (``scoup.query.presence``)."""
        return len(self.everyday) >= LEAST_WORDS

    def with_everyday(self) -> TextVectors:
        """Add the mean of the everyday words to the canonical phrases, which only protocols do without, unless there
        are too few words.
        """
        return replace(self, canonical=with_everyday(self.canonical, self.everyday))


def encode_texts(
    encoder: TextEncoder, field: CodedScene, texts: Sequence[str], source: str | None = None
) -> TextVectors:
    """Encode texts to query a field with, the canonical phrases, and everyday words.

    Args:
        encoder: of the model whose embeddings the field contains.
        field: to be queried.
        texts: Q phrases.
        source: name of the encoder in messages; by default its model.

    Warns:
        ScoupWarning: encoder and field name different models, or the table lacks the canonical phrases.
    """
    check_arguments("encode_texts", encoder=(encoder, TextEncoder), field=(field, CodedScene))
    source = source or encoder.name or "the word table"
    if encoder.dim != field.dim:
        raise InputError(
            f"{source}: has vectors of {counted(encoder.dim, 'dimension')}, but the field contains embeddings of "
            f"{field.dim}; " + _where_words_are(field, encoder)
        )
    _warn_of_another_model(encoder.name, field.embedding_model, source)
    queries = encoder.encode(texts)
    try:
        canonical = encoder.canonical()
    except UnknownNameError as error:
        canonical = _mean_phrase(encoder, source, error)
    return TextVectors(tuple(texts), queries, canonical, encoder.everyday(), source)


def _mean_phrase(encoder: TextEncoder, source: str, error: UnknownNameError) -> Tensor:
    """The unit mean [1, D] of a table's names, for canonical phrases that the table lacks."""
    words = encoder.everyday()
    phrases = ", ".join(CANONICAL_PHRASES)
    if len(words) < LEAST_WORDS:
        raise InputError(
            f"{source}: lacks {error.name!r}, but relevancy compares every text with the phrases {phrases}; encode "
            f"them into the table too, or pass a table of {LEAST_WORDS} names or more"
        ) from error
    warnings.warn(
        f"{source}: lacks {error.name!r}; texts are compared with the mean of its {len(words):,} names in place of the "
        f"phrases {phrases}",
        ScoupWarning,
        stacklevel=4,
    )
    return torch.nn.functional.normalize(words.mean(0, keepdim=True), dim=1)


def _warn_of_another_model(given: str, wanted: str, source: str) -> None:
    """Warn of vectors of another model: they may have the same size, but cosines with them mean nothing."""
    if given and wanted and _words_of(given) != _words_of(wanted):
        warnings.warn(
            f"{source}: its vectors come from {given}, the field's embeddings from {wanted}; answers mean nothing "
            "unless both are one model by two names",
            ScoupWarning,
            stacklevel=3,
        )


def _words_of(model: str) -> set[str]:
    """The words that tell models apart in their names, which transformers and open_clip write differently."""
    return set(re.findall(r"[a-z]+[0-9]+[a-z]*|[a-z]+|[0-9]+", model.lower())) - _PUBLISHERS


def _where_words_are(field: CodedScene, other: TextEncoder) -> str:
    """The remedy for vectors of another size than the field's embeddings, from the encoder ``other``."""
    named = field.embedding_model
    if named == COLORS:
        return NO_WORDS_FOR_COLORS
    table = f"a word table of {field.dim} dimensions, made with the model that embedded its regions"
    if field.info.words is not None:
        return f"the field was built for the table {field.info.words}: pass that, or {table}"
    if not named:
        return f"the field does not name its model: pass {table}"
    if named == other.name:
        return f"so {named}, which the field names, did not embed its regions: pass {table}"
    return f"the field names the model {named}: pass that, or a table made with it"
