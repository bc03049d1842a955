"""Questions: texts as vectors, what they are compared with, and the rules by which they are answered."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Generic, TypeAlias, TypeVar

import numpy as np
import torch
from torch import Tensor

from scoup.base import InputError, ScoupWarning, UnknownNameError, brief, counted
from scoup.field import Field, NameTable
from scoup.models import CANONICAL_PHRASES, LEAST_WORDS, TextEncoder, with_everyday, words_problem
from scoup.query import constants
from scoup.query.expression import Expression, parse_expression
from scoup.query.phrases import explained
from scoup.query.presence import check_share, presence_threshold
from scoup.scene import LEAST_EMBEDDING, query_vectors

if TYPE_CHECKING:
    from scoup.query.frame import Frame

Several: TypeAlias = "list[str] | tuple[str, ...] | list[Expression] | Tensor | np.ndarray"
"""Several texts, or vectors [Q, D] in their place."""
Asked = TypeVar("Asked", covariant=True)
Found = TypeVar("Found")
MOST_TEXTS = 16
"""Questions with more texts are not cached."""
# Words that do not tell models apart.
_PUBLISHERS = {"open", "clip", "laion", "openai", "google", "hf", "hub"}


@dataclass(frozen=True, eq=False)
class AskedText:
    """A text in the space of embeddings, and the level whose relevancy to it is shown as heat."""

    word: str  # what it is called, such as "mug" for "mugs"
    query: Tensor  # [1, D]
    canonical: Tensor  # [P, D]
    level: int
    present_from: float | None  # of the question


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
        """Return whether there are enough everyday words to judge presence (``scoup.query.presence``)."""
        return len(self.everyday) >= LEAST_WORDS

    @property
    def compared(self) -> Tensor:
        """The words [B, D] float32 that things are compared with; the canonical phrases replace too few."""
        return (self.everyday if self.can_judge_presence else self.canonical).float().cpu()

    def with_everyday(self) -> TextVectors:
        """Add the mean of the everyday words to the canonical phrases, which only protocols do without, unless there
        are too few words.
        """
        return replace(self, canonical=with_everyday(self.canonical, self.everyday))


@dataclass(frozen=True, eq=False, repr=False)
class Question(TextVectors, Generic[Asked]):
    """Texts and the rules of their answers, made by ``field.question(texts, ...)``.

    A question of one text (``Question[str]``) has one answer, a question of several a list of them.

    Example:
        >>> question = field.question(["kettle", "wooden table"], threshold=0.6)
        >>> question.texts, question.threshold, question.queries.shape
        (('kettle', 'wooden table'), 0.6, torch.Size([2, 16]))
    """

    threshold: float | None = None
    """Gaussians with relevancy above this, 0 to 1 once it is rescaled over the scene, answer in place of things. None:
    things answer, or in a field without things the Gaussians above the threshold at which the answer changes least
    (``scoup.query.votes``)."""
    level: int | None = None
    """Position of the one that answers; ``field.question`` also takes its name. None: the best, for each text."""
    present_from: float | None = None
    """The score from which a text counts as present (``scoup.query.presence``). None: presence is not judged, and
    something is found for any text."""
    is_single: bool = False
    """It was one text, not a list, and so is the answer."""
    words: tuple[str, ...] = ()
    """Of each text, the word that it is a form of (``TextEncoder.word_of``); () if these are the texts."""
    near: tuple[str | None, ...] = ()
    """Of each text, the name of things that is nearly the same (``constants.NEAR_NAME``), if there is one."""
    asked: tuple[tuple[str, Expression], ...] = ()
    """Each text as it was asked, and what it means, where one is more than a text alone: a phrase or expression, which
    ``texts`` are those of. Otherwise empty."""
    everything: Question[Any] | None = None
    """The words that name all objects, where it asks for things that it does not name."""
    frame: Frame | None = None
    """What left, front and up mean in phrases; None: ``field.frame()``."""
    model: str = ""
    """Id of the model of its vectors; "" if unknown."""

    def __post_init__(self) -> None:
        check_share("the threshold", self.threshold)

    @property
    def nbytes(self) -> int:
        """Bytes of its own vectors."""
        return self.queries.nbytes + self.canonical.nbytes

    @classmethod
    def from_vectors(cls, vectors: TextVectors, **options: Any) -> Question[Any]:
        """Make a question of vectors, with attributes as options."""
        return cls(**{**vars(vectors), **options})

    @classmethod
    def encoded(
        cls, encoder: TextEncoder, texts: Sequence[str], source: str = "", present_from: float | None = None
    ) -> Question[Any]:
        """Make a question of texts for several fields; messages about everyday words name their ``source``."""
        vectors = encode_texts(encoder, texts)
        least = presence_threshold(len(vectors.everyday), source, present_from)
        words = tuple(map(encoder.word_of, texts))
        return cls.from_vectors(vectors.with_everyday(), present_from=least, words=words)

    def shaped(self, results: list[Found]) -> Found | list[Found]:
        """Return the results of all texts, or the only one if the question was one text."""
        return results[0] if self.is_single else results

    def vectors_of(self, number: int, level: int) -> AskedText:
        """Return one of its texts as vectors, at the level that answers it."""
        query = self.queries[number : number + 1].clone()
        word = (self.words or self.texts)[number]
        return AskedText(word, query, self.canonical, level, self.present_from)

    def one(self, number: int, **options: Any) -> Question[Asked]:
        """Return the question of one of its texts, with some attributes replaced."""
        return self.some(slice(number, number + 1), **options)

    def some(self, chosen: slice, **options: Any) -> Question[Asked]:
        """Return the question of some of its texts, with some attributes replaced."""
        some = {name: getattr(self, name)[chosen] for name in ("texts", "queries", "near", "words")}
        return replace(self, **{**some, "asked": (), **options})


def make_question(
    field: Field,
    encoder: TextEncoder,
    texts: Any,
    always: bool = False,
    present_from: float | None = None,
    threshold: float | None = None,
    level: str | int | None = None,
    frame: Frame | None = None,
) -> Question[Any]:
    """Make a question; ``LanguageField.question`` documents it."""
    is_single = isinstance(texts, (str, Expression))
    given = (texts,) if is_single else tuple(texts) if isinstance(texts, (list, tuple)) else ()
    if isinstance(texts, (list, tuple)) and not texts:
        raise InputError('pass at least one text, for example "kettle"')
    if not all(isinstance(text, (str, Expression)) for text in given):
        given = ()  # vectors, or an invalid question

    def made() -> Question[Any]:
        asked = tuple(
            (str(text), text if isinstance(text, Expression) else parse_expression([text], encoder.names))
            for text in given
        )
        alone = [tree.root for _, tree in asked if isinstance(tree.root, str)]
        every = [*dict.fromkeys(text for _, tree in asked for text in tree.texts)]
        words = alone if len(alone) == len(asked) else every
        vectors = encode_texts(encoder, words, any(isinstance(text, str) for text in given))
        if not words:
            queries = query_vectors(_given_vectors(texts), field.dim)
            names = tuple(f"query {number}" for number in range(1, len(queries) + 1))
            vectors = replace(vectors, texts=names, queries=queries)
        wants_everything = any(tree.wants_everything for _, tree in asked)
        return Question.from_vectors(
            vectors.with_everyday(),
            threshold=threshold,
            present_from=(
                None if always else presence_threshold(len(vectors.everyday), vectors.source, present_from)
            ),
            is_single=is_single,
            asked=() if words is alone else asked,
            everything=naming_question(field, encoder) if wants_everything else None,
            frame=frame,
            level=None if level is None else field.level_index(level),
            words=tuple(map(encoder.word_of, words)) if len(words) <= MOST_TEXTS else (),
            near=_near_names(field, encoder, vectors),
            model=encoder.name or field.embedding_model,
        )

    if not 0 < len(given) <= MOST_TEXTS:
        return made()
    return field.kept((Question, given, is_single, always, present_from, threshold, level, frame), made)


def naming_question(field: Field, encoder: TextEncoder, words: Sequence[str] = ()) -> Question[Any]:
    """Return the question of the words that name things, each as it is; by default all names of the field's word table,
    or everyday words and the names that a model gave to its things."""

    def made() -> Question[Any]:
        given = None if field.thing_table is None else field.thing_table.names
        every = words or encoder.vocabulary()
        if not words and given is not None and encoder.names is None:  # a table has only its names
            folded = {word.casefold() for word in every}
            every = (*every, *(text for text in given.texts if text.casefold() not in folded))
        if not every:
            raise InputError(f"{encoder.source}: has no word that may name things; pass `words`")
        return make_question(field, encoder, literal([*dict.fromkeys(every)]))

    return field.kept((naming_question, tuple(words)), made)


def literal(texts: Any) -> Any:
    """Return a list of texts for a question that takes each as it is, without relations, orders or operators."""
    if not isinstance(texts, (list, tuple)):
        return texts
    return [Expression(text) if isinstance(text, str) else text for text in texts]


def _near_names(field: Field, encoder: TextEncoder, vectors: TextVectors) -> tuple[str | None, ...]:
    names = None if field.thing_table is None else field.thing_table.names
    if names is None:
        return ()

    def encode(texts: tuple[str, ...]) -> Tensor:
        return field.kept((near_names, texts), lambda: encoder.encode(texts))

    return near_names(names, encoder, vectors, encode)


def near_names(
    names: NameTable, encoder: TextEncoder, vectors: TextVectors, encode: Callable[[tuple[str, ...]], Tensor]
) -> tuple[str | None, ...]:
    """Return for each text the name of things that is nearly the same; () if all texts are names. ``encode`` is that of
    the encoder, with a cache."""
    if all(names.number(text) is not None for text in vectors.texts):
        return ()
    known = tuple(text for row in names.rows.unique() if (text := names.texts[row]) in encoder)
    if not known:
        return ()
    cosines, rows = (vectors.queries @ encode(known).to(vectors.queries).T).max(1)
    return tuple(
        known[row] if cosine >= constants.NEAR_NAME else None
        for cosine, row in zip(cosines.tolist(), rows.tolist(), strict=True)
    )


def _given_vectors(texts: Any) -> Tensor:
    try:
        vectors = torch.as_tensor(texts)
    except (TypeError, ValueError, RuntimeError):
        vectors = torch.empty(())
    if not vectors.dim():
        raise InputError(
            f"expected a text, a list of texts, or vectors [Q, D], got {type(texts).__name__} {str(texts)[:60]}"
        )
    return vectors


def check_encoder(field: Field, encoder: TextEncoder) -> None:
    """Refuse an encoder whose vectors have another size than the field's embeddings; warn if both name their models and
    these differ."""
    if encoder.dim != field.dim:
        raise InputError(
            f"{encoder.source}: has vectors of {counted(encoder.dim, 'dimension')}, but the field contains embeddings "
            f"of {field.dim}; " + _where_words_are(field, encoder)
        )
    warn_of_another_model(encoder.name, field.embedding_model, encoder.source)


def encode_texts(encoder: TextEncoder, texts: Sequence[str], parsed: bool = True) -> TextVectors:
    """Encode texts to query fields with, the canonical phrases, and everyday words; warn of a table that lacks the
    canonical phrases. ``parsed`` says that texts with relations and orders could have been asked in their place."""
    try:
        queries = encoder.encode(texts)
    except UnknownNameError as error:
        raise explained(error, encoder) if parsed else error from None
    try:
        canonical = encoder.canonical()
    except UnknownNameError as error:
        canonical = _mean_phrase(encoder, error)
    return TextVectors(tuple(texts), queries, canonical, encoder.everyday(), encoder.source)


def _mean_phrase(encoder: TextEncoder, error: UnknownNameError) -> Tensor:
    """Return the unit mean [1, D] of a table's names, for canonical phrases that the table lacks."""
    words, source = encoder.everyday(), encoder.source
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


def warn_of_another_model(given: str, wanted: str, source: str) -> None:
    """Warn of vectors of another model: they may have the same size, but cosines with them mean nothing. Where one is
    not named, as in features that others have made, nothing is known."""
    if given and wanted and _words_of(given) != _words_of(wanted):
        warnings.warn(
            f"{source}: its vectors come from {given}, the field's embeddings from {wanted}; answers mean nothing "
            "unless both are one model by two names",
            ScoupWarning,
            stacklevel=3,
        )


def _words_of(model: str) -> set[str]:
    """Return the words that tell models apart in their names, which transformers and open_clip write differently."""
    return set(re.findall(r"[a-z]+[0-9]+[a-z]*|[a-z]+|[0-9]+", model.lower())) - _PUBLISHERS


def _where_words_are(field: Field, other: TextEncoder) -> str:
    """Return the remedy for vectors of another size than the field's embeddings, from the encoder ``other``."""
    named = field.embedding_model
    if problem := words_problem(named):
        return problem
    table = f"a word table of {field.dim} dimensions, made with the model that embedded its regions"
    if field.dim < LEAST_EMBEDDING:
        table += "; if they are codes of an autoencoder, decode them (scoup convert with `autoencoder`) and build again"
    if field.info.words is not None:
        return f"the field was built for the table {field.info.words}: pass that, or {table}"
    if not named:
        return f"the field does not name its model: pass {table}"
    if named == other.name:
        return f"so {named}, which the field names, did not embed its regions: pass {table}"
    return f"the field names the model {named}: pass that, or a table made with it"
