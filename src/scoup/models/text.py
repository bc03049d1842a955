"""Phrases to unit vectors: CLIP and SigLIP text models, or a word table for work without a model."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from scoup.base import InputError, ScoupError, UnknownNameError, card, check_arguments, counted, listed
from scoup.models.embedders import TEXT_MODELS, open_text_model
from scoup.models.entry import Encode
from scoup.models.hub import ModelIdentity
from scoup.models.plain_colors import COLORS
from scoup.models.word_cache import CachedTexts, EncodeUnit
from scoup.models.word_table import WordTable, refuse_other_file
from scoup.models.words import CANONICAL_PHRASES, EVERYDAY_WORDS, with_everyday

_NO_WORDS = (
    "these regions were embedded by their colours, without a model, and cannot be queried in words; "
    "extract them with a CLIP model as embedder and build the field again"
)
_BATCH = 64
_OTHER_WORDS = "ask one of its names"
_OR_MODEL = ", or use the model that embedded the regions instead of this table"
ARTICLES = ("the", "a", "an")
LONGEST = 1000  # characters of a phrase; models read a few hundred at most
_SHOWN = 50  # names in the picture of a notebook


Encoder: TypeAlias = "TextEncoder | Mapping[str, Tensor | ArrayLike] | str | Path"
"""Source of vectors of texts: an encoder, a dict of name -> vector, a word table's file, or a model id."""


class TextEncoder:
    """Turns phrases into unit vectors, with ``TextEncoder.open``; usable as a context manager.

    Phrases are encoded as they stand, without a prompt template. A model is loaded for the first phrase whose vector is
    not in the user's cache.

    Attributes:
        name: id of the embedding model, "" if a table does not name it. Queries of a field must come from the model
            that embedded its regions.
        dim: D, the size of a vector.
        names: those in a table or dict; None for a model, which takes any phrase.
        source: what it was opened from, for messages.

    Example:
        >>> encoder = scoup.TextEncoder.open("scene/words.npz")
        >>> encoder.encode(["kettle"]).shape == (1, encoder.dim)
        True
    """

    def __init__(
        self, name: str, dim: int, encode: Encode | None, names: tuple[str, ...] | None = None
    ) -> None:
        self.name = name
        self.dim = dim
        self.names = names
        self.source = name or "the word table"
        self._forms = None if names is None else {name.strip().casefold() for name in names}
        self._encode = encode
        self._made_by: tuple[Callable[..., TextEncoder], tuple[Any, ...]] | None = None
        self._canonical: Tensor | None = None
        self._everyday: Tensor | None = None
        self._model: CachedTexts | None = None

    def __contains__(self, phrase: str) -> bool:
        """Return whether it encodes a phrase: a table has it in one of its forms (``word_forms``)."""
        return self._forms is None or not self._forms.isdisjoint(word_forms(phrase))

    def __reduce__(self) -> tuple[Callable[..., TextEncoder], tuple[Any, ...]]:
        if self._encode is None or self._made_by is None:
            return TextEncoder, (self.name, self.dim, self._encode, self.names)
        return self._made_by  # another process opens the model again

    def __deepcopy__(self, memo: dict[int, Any]) -> TextEncoder:
        return self  # a model is large, and nothing changes it

    def __repr__(self) -> str:
        what = (
            "any text"
            if self.names is None
            else f"{counted(len(self.names), 'name')}: {listed(self.names, 4)}"
        )
        return f"TextEncoder({self.name or 'unnamed model'}, {self.dim} dimensions, {what})"

    def _repr_html_(self) -> str:
        facts = {
            "dimensions": self.dim,
            "texts": "any" if self.names is None else f"{len(self.names):,}: {listed(self.names, 12)}",
            "state": "closed" if self._encode is None else "open",
        }
        return card(f"Text encoder: {self.name or 'unnamed model'}", facts, self._similarities())

    def _similarities(self) -> NDArray[np.uint8] | None:
        """Return the cosines of the first names with each other, dark where alike: [H, W, 3]; None without names."""
        if self.names is None or self._encode is None:
            return None
        vectors = self.encode(self.names[:_SHOWN])
        cosines = (vectors @ vectors.T).clamp(0, 1).numpy()
        side = max(1, 200 // len(cosines))
        grey = np.kron(255 - 200 * cosines, np.ones((side, side))).astype(np.uint8)
        return np.repeat(grey[..., None], 3, axis=2)

    @classmethod
    def open(
        cls,
        model_or_table: str | Path | Mapping[str, Tensor | ArrayLike],
        revision: str | None = None,
        device: torch.device | str = "cpu",
    ) -> TextEncoder:
        """Open a text encoder of a word table, a dict, or a CLIP or SigLIP model.

        Args:
            model_or_table: a word table (.npz, .json, .safetensors; see ``scoup.models.WordTable.load``), a dict
                of name -> vector [D], or a model: a folder or hub id that transformers knows, such as
                "laion/CLIP-ViT-B-16-laion2B-s34B-b88K", or "open_clip:ARCHITECTURE/PRETRAINED", such as
                "open_clip:ViT-B-16/laion2b_s34b_b88k". A name with the extension of a table is always a file.
            revision: branch, tag or commit of a hub model.
            device: where the model runs. Vectors are always returned on the CPU.

        Raises:
            MissingFileError, FileFormatError: the table is missing or damaged, or the file is not a table.
            InputError: the vectors of a dict differ in size, or are not vectors.
            ScoupError: the package or the weights that the model needs are missing.
        """
        check_arguments("TextEncoder.open", model_or_table=(model_or_table, (Path, Mapping)))
        if isinstance(model_or_table, Mapping):
            return cls._of_table(WordTable.of(model_or_table))
        text = str(model_or_table)
        if WordTable.is_meant(text):
            return cls._of_table(WordTable.load(text), text)
        if text == COLORS:
            raise ScoupError(_NO_WORDS)
        refuse_other_file(text)

        def load() -> tuple[EncodeUnit, ModelIdentity]:
            encode, identity = open_text_model(text, revision, device)
            return partial(_encoded, encode), identity

        model = CachedTexts(text, revision, device, load)
        opened = cls(text, int(model.probe.shape[1]), model.encode)
        opened._model, opened.source = model, text
        opened._made_by = TextEncoder.open, (text, revision, device)
        return opened

    @classmethod
    def _of_table(cls, table: WordTable, source: str = "") -> TextEncoder:
        vectors = torch.from_numpy(table.vectors)
        rows = [*enumerate(table.names)][::-1]
        exact = {name: row for row, name in rows}
        folded = {" ".join(name.split()).casefold(): row for row, name in rows}
        # No model has a blank in its name; simulated vectors are named so.
        remedy = _OTHER_WORDS + (_OR_MODEL if table.model and " " not in table.model else "")

        def encode(phrases: list[str]) -> Tensor:
            found = []
            for phrase in phrases:
                row = exact.get(phrase)
                forms = (folded[form] for form in word_forms(phrase) if form in folded)
                row = next(forms, None) if row is None else row
                if row is None:
                    raise UnknownNameError("text embedding", phrase, table.names, str(table.path), remedy)
                found.append(row)
            return vectors[found]

        opened = cls(table.model, vectors.shape[1], encode, table.names)
        opened._made_by, opened.source = (TextEncoder._of_table, (table, source)), source or opened.source
        return opened

    def encode(self, phrases: Sequence[str]) -> Tensor:
        """Return [Q, D] float32 unit vectors of the phrases, on the CPU.

        Raises:
            UnknownNameError: a table lacks a phrase in all of its forms (``word_forms``); the message lists the nearest
                names.
            InputError: the encoder is closed, or a phrase is not text, blank, or longer than ``LONGEST``.
        """
        if self._encode is None:
            raise InputError("this text encoder is closed; open it again")
        if isinstance(phrases, str):
            raise InputError(f"expected a list of phrases, got one string; pass [{phrases!r}]")
        for phrase in phrases:
            if not isinstance(phrase, str) or not phrase.strip():
                raise InputError(f"a phrase to encode must be a text that is not blank, got {phrase!r}")
            if len(phrase) > LONGEST:
                raise InputError(
                    f"{phrase[:80]!r}... ({len(phrase):,} characters): is too long for a phrase; pass at most "
                    f"{LONGEST:,} characters"
                )
            if any("\ud800" <= letter <= "\udfff" for letter in phrase):  # of an argument in another encoding
                raise InputError(f"{phrase[:80]!a}: is not valid Unicode; pass the phrase in UTF-8")
        if not phrases:
            return torch.zeros(0, self.dim)
        return _encoded(self._encode, phrases) if self._model is None else self._model.encode(phrases)

    def canonical(self, everyday: bool = False) -> Tensor:
        """Return [4, D] float32 unit vectors of the canonical phrases (``scoup.models.words.CANONICAL_PHRASES``).

        Args:
            everyday: add the mean of everyday words as a fifth row (``scoup.models.words.with_everyday``), as
                `scoup query` does. The protocols of the papers have no such row.

        Raises:
            UnknownNameError: a table lacks a phrase.
        """
        if self._canonical is None:
            self._canonical = self.encode(CANONICAL_PHRASES)
        return with_everyday(self._canonical, self.everyday()) if everyday else self._canonical

    def everyday(self) -> Tensor:
        """Return [B, D] float32 unit vectors of everyday words (``scoup.models.words``).

        For a table all its names except the canonical phrases. For a model a fixed list of words, which are encoded
        once, and read from the user's cache afterwards.
        """
        if self._model is not None:
            return self._model.everyday
        if self._everyday is None:
            self._everyday = self.encode(self._usual_names())
        return self._everyday

    def vocabulary(self) -> tuple[str, ...]:
        """Return the words by which things are named by default: everyday words; of a table, all its names but the
        canonical phrases.
        """
        cleaned = (" ".join(name.split()) for name in self._usual_names())
        return tuple(dict.fromkeys(filter(None, cleaned)))

    def _usual_names(self) -> list[str]:
        """Return the names of a table, or everyday words, without the canonical phrases."""
        names = EVERYDAY_WORDS if self.names is None else self.names
        return [name for name in names if name.strip().casefold() not in CANONICAL_PHRASES]

    def word_of(self, phrase: str) -> str:
        """Return the word of ``vocabulary`` that a phrase is a form of ("mug" for "mugs"), else the phrase."""
        words = {word.casefold(): word for word in self.vocabulary()}
        return next((words[form] for form in word_forms(phrase) if form in words), phrase)

    def close(self) -> None:
        """Release the model or table."""
        self._encode = self._canonical = self._everyday = self._model = None

    def __enter__(self) -> TextEncoder:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def word_forms(phrase: str) -> list[str]:
    """Return the forms of a phrase that a table may have: without capitals and needless blanks, without an article, and
    in the singular.

    Example:
        >>> from scoup.models.text import word_forms
        >>> word_forms("The coffee mugs")
        ['the coffee mugs', 'coffee mugs', 'coffee mug']
    """
    folded = " ".join(phrase.split()).casefold()
    article, _, rest = folded.partition(" ")
    bare = rest if article in ARTICLES and rest else folded
    endings = (("s", ""), ("es", ""), ("ies", "y"))
    singular = [
        bare.removesuffix(ending) + instead
        for ending, instead in endings
        if bare.endswith(ending) and len(bare) > len(ending) + 1
    ]
    return list(dict.fromkeys([folded, bare, *singular]))


def words_problem(embedding_model: str) -> str:
    """Return why no text can be compared with embeddings of a model; "" where one can."""
    return _NO_WORDS if embedding_model == COLORS else ""


def check_model(name: str) -> None:
    """Raise InputError or FileFormatError for a name that no text model can have; none is opened."""
    if name != COLORS:
        refuse_other_file(name)
        TEXT_MODELS.find(name)


def _encoded(encode: Encode, phrases: Sequence[str]) -> Tensor:
    """Return unit vectors [Q, D] float32 of one phrase or more, on the CPU."""
    starts = range(0, len(phrases), _BATCH)
    vectors = torch.cat([encode(list(phrases[start : start + _BATCH])) for start in starts])
    return torch.nn.functional.normalize(vectors.float().cpu(), dim=1)
