"""Questions to a field: its text encoder, and texts and options made into a ``Question``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from scoup.base.arguments import check_arguments
from scoup.base.errors import InputError, MissingFileError
from scoup.query.coded_scene import CodedScene
from scoup.query.expression import Expression
from scoup.query.presence import presence_threshold
from scoup.query.question import Question
from scoup.query.text_vectors import TextVectors, encode_texts
from scoup.scene.directions import query_vectors

if TYPE_CHECKING:
    from scoup.models.text import TextEncoder

Texts: TypeAlias = "str | Sequence[str] | Tensor | np.ndarray"
"""One text or several, or vectors [D] or [Q, D] in their place."""
Encoder: TypeAlias = "TextEncoder | Mapping[str, Tensor | ArrayLike] | str | Path"
"""What turns texts into vectors: an encoder, a dict of name -> vector, a word table's file, or a model id."""
MOST_TEXTS = 16
"""Questions with more texts are not kept."""


class AskedScene(CodedScene):
    """A scene with a text encoder, which makes questions."""

    _encoder: TextEncoder | None = None
    _encoder_name: str = ""  # the argument that opened it; empty for a dict or an encoder

    @property
    def encoder_source(self) -> str:
        """The word table or model that encodes texts.

        Raises:
            InputError: the field names none.
            MissingFileError: the table is missing.
        """
        words = self.info.words
        if words is not None:
            if not words.is_file():
                problem = "is missing, and the field names it as its word table"
                raise MissingFileError(words, problem, "pass encoder=..., the place where it is now")
            return str(words)
        if not self.embedding_model:
            raise InputError(
                f"{self.path or 'this field'}: names no embedding model; pass encoder=..., a word table, a model id, "
                "or a dict of name -> vector"
            )
        return self.embedding_model

    def text_encoder(self, encoder: Encoder | None = None) -> TextEncoder:
        """Return the encoder of this field's texts; opened at its first use and kept.

        Args:
            encoder: used from now on; None for the last one, at first the table or model that the field names.

        Raises:
            InputError: the field names none.
            MissingFileError, FileFormatError, ScoupError: it cannot be opened (``TextEncoder.open``).
        """
        from scoup.models.text import TextEncoder

        kinds = (TextEncoder, Mapping, str, Path, type(None))
        check_arguments("text_encoder", encoder=(encoder, kinds))
        if encoder is None:
            if self._encoder is not None:
                return self._encoder
            encoder = self.encoder_source
        name = str(encoder) if isinstance(encoder, (str, Path)) else ""
        if isinstance(encoder, TextEncoder):
            self._encoder = encoder
        elif self._encoder is None or not name or name != self._encoder_name:
            self.recent.clear()
            self._encoder = TextEncoder.open(encoder, device=self.codebook.device)
        self._encoder_name = name
        return self._encoder

    def keep_encoder_of(self, other: AskedScene) -> None:
        """Use the encoder that another field has open, or would open."""
        self._encoder, self._encoder_name = other._encoder, other._encoder_name

    def question(
        self,
        texts: Texts | Expression,
        *,
        encoder: Encoder | None = None,
        always: bool = False,
        present_from: float | None = None,
        threshold: float | None = None,
        level: str | int | None = None,
    ) -> Question:
        """Make a question, which every method of a field takes; texts alone are a question without options.

        Args:
            texts: one or several; or vectors [D] or [Q, D] of the field's embedding model, of any norm but zero; or an
                expression (``scoup.parse_expression``), for ``select``.
            encoder: see ``text_encoder``. For vectors, a dict of the canonical phrases ("object", "things", "stuff",
                "texture") is enough.
            always: find something for any text; presence is not judged.
            present_from: by default 0.37, where there are enough everyday words; see ``Question``.
            threshold, level: see ``Question``.

        Raises:
            InputError, UnknownNameError: texts or options do not fit the field, a number is out of range, or the field
                names no encoder.
            MissingFileError, FileFormatError, ScoupError: the encoder cannot be opened (``TextEncoder.open``).

        Example:
            >>> field.question("kettle", level="m", always=True).level
            1
        """
        source = self.text_encoder(encoder)
        key = _question_key(texts, source, always, present_from, threshold, level)
        known = None if key is None else self.recent.get(key)
        if known is not None:
            return known
        expression = texts if isinstance(texts, Expression) else None
        words = list(texts.texts) if isinstance(texts, Expression) else texts
        vectors = self._vectors(words)
        question = Question.from_vectors(
            vectors.with_everyday(),
            threshold=threshold,
            present_from=None if always else presence_threshold(vectors, present_from),
            is_single=_is_single(words),
            expression=expression,
            level=None if level is None else self.level_index(level),
        )
        if key is not None:
            self.recent.keep(key, question, question.queries.nbytes + question.canonical.nbytes)
        return question

    def _vectors(self, texts: Texts) -> TextVectors:
        words = [texts] if isinstance(texts, str) else texts
        if isinstance(words, (list, tuple)) and all(isinstance(word, str) for word in words):
            if not words:
                raise InputError('pass at least one text, for example "kettle"')
            return encode_texts(self.text_encoder(), self, words, self._encoder_name)
        queries = query_vectors(_as_vectors(texts), self.dim)
        names = tuple(f"query {number}" for number in range(1, len(queries) + 1))
        compared = encode_texts(self.text_encoder(), self, [], self._encoder_name)
        return replace(compared, texts=names, queries=queries)


def _question_key(texts: Any, *options: Any) -> tuple[Any, ...] | None:
    """Return the cache key of a question; None for questions that are not cached: vectors, and many texts."""
    words = tuple(texts) if isinstance(texts, (list, tuple)) else texts
    if isinstance(words, tuple):
        is_kept = len(words) <= MOST_TEXTS and all(isinstance(word, str) for word in words)
    else:
        is_kept = isinstance(words, (str, Expression))
    return (type(texts), words, *options) if is_kept else None


def _is_single(texts: Texts) -> bool:
    if isinstance(texts, (list, tuple)) and any(isinstance(text, str) for text in texts):
        return False
    return isinstance(texts, str) or _as_vectors(texts).dim() == 1


def _as_vectors(texts: Texts) -> Tensor:
    try:
        vectors = torch.as_tensor(texts)
    except (TypeError, ValueError, RuntimeError):
        vectors = torch.empty(())
    if not vectors.dim():
        raise InputError(
            f"expected a text, a list of texts, or vectors [D] or [Q, D], got {type(texts).__name__} {str(texts)[:60]}"
        )
    return vectors
