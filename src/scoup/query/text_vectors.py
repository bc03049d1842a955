"""Texts as vectors: the queries, and what they are compared with."""

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
from scoup.models.word_table import is_table
from scoup.models.words import CANONICAL_PHRASES, LEAST_WORDS, with_everyday
from scoup.query.coded_scene import CodedScene

_PUBLISHERS = {
    "open",
    "clip",
    "laion",
    "openai",
    "google",
    "hf",
    "hub",
}  # words that do not tell models apart


@dataclass(frozen=True, eq=False)
class TextVectors:
    """Queries, and the vectors that they are compared with; all of unit norm and from one encoder.

    Attributes:
        texts: Q queries.
        queries: [Q, D], of the texts.
        canonical: [P, D] of the canonical phrases.
        everyday: [B, D] of everyday words.
        source: the table or model they are from.
    """

    texts: tuple[str, ...]
    queries: Tensor  # [Q, D]
    canonical: Tensor  # [P, D]
    everyday: Tensor  # [B, D]
    source: str = ""

    __repr__ = brief

    def of(self, texts: Sequence[str]) -> Tensor:
        """[len(texts), D] vectors of some of the texts."""
        return torch.stack([self.queries[self.texts.index(text)] for text in texts])

    @property
    def can_judge_presence(self) -> bool:
        """Whether there are enough everyday words for a z-score (``scoup.query.presence``)."""
        return len(self.everyday) >= LEAST_WORDS

    def with_everyday(self) -> TextVectors:
        """The same, with the mean of the everyday words as one more canonical phrase, which only protocols do without.

        The same as before where there are too few words.
        """
        return replace(self, canonical=with_everyday(self.canonical, self.everyday))


def encode_texts(
    encoder: TextEncoder, field: CodedScene, texts: Sequence[str], source: str | None = None
) -> TextVectors:
    """Vectors of texts to query a field with, of the canonical phrases, and of everyday words.

    Args:
        encoder: of the model whose embeddings the field holds.
        field: to be queried.
        texts: Q phrases, encoded as they stand.
        source: what messages call the encoder; by default its model.

    Warns:
        ScoupWarning: encoder and field name different models, or the table lacks the canonical phrases.

    Raises:
        UnknownNameError: a text is not in the encoder's table; the nearest names are listed.
        InputError: the vectors have another size than the field's embeddings, or the table lacks the canonical phrases
            and has too few names to stand in for them.
    """
    check_arguments("encode_texts", encoder=(encoder, TextEncoder), field=(field, CodedScene))
    source = source or encoder.name or "the word table"
    if encoder.dim != field.dim:
        raise InputError(
            f"{source}: gives vectors of {counted(encoder.dim, 'dimension')}, but the field holds embeddings of "
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
    """[1, D] unit mean of a table's names, which stands in for canonical phrases that the table lacks."""
    words = encoder.everyday()
    phrases = ", ".join(CANONICAL_PHRASES)
    if len(words) < LEAST_WORDS:
        raise InputError(
            f"{source}: lacks {error.name!r}; relevancy compares every text with the phrases {phrases}; encode them "
            f"into the table too, or give a table of {LEAST_WORDS} names or more"
        ) from error
    warnings.warn(
        f"{source}: lacks {error.name!r}; texts are compared with the mean of its {len(words):,} names in place of the "
        f"phrases {phrases}",
        ScoupWarning,
        stacklevel=4,
    )
    return torch.nn.functional.normalize(words.mean(0, keepdim=True), dim=1)


def _warn_of_another_model(given: str, wanted: str, source: str) -> None:
    """Vectors of another model fit in size only: cosines with them mean nothing."""
    if given and wanted and not is_table(wanted) and _words_of(given) != _words_of(wanted):
        warnings.warn(
            f"{source}: its vectors come from {given}, the field's embeddings from {wanted}; answers mean nothing "
            "unless both are one model by two names",
            ScoupWarning,
            stacklevel=3,
        )


def _words_of(model: str) -> set[str]:
    """What tells models apart in their names, which transformers and open_clip write differently."""
    return set(re.findall(r"[a-z]+[0-9]+[a-z]*|[a-z]+|[0-9]+", model.lower())) - _PUBLISHERS


def _where_words_are(field: CodedScene, other: TextEncoder) -> str:
    """The remedy for vectors of another size than the field's embeddings; ``other`` is what gave them."""
    named = field.embedding_model
    if named == COLORS:
        return NO_WORDS_FOR_COLORS
    table = f"a table of words of {field.dim} dimensions, made with the model that embedded its regions"
    if not named:
        return f"the field does not name its model: give {table}"
    if is_table(named):
        return f"the field was built for the table {named}: give that, or {table}"
    if named == other.name:
        return f"so {named}, which the field names, did not embed its regions: give {table}"
    return f"the field names the model {named}: give that, or a table made with it"
