"""A language field: the data of ``scoup.field.Field``, and the questions to it, each a call of this room."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from numbers import Integral
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, overload

from scoup.base import InputError, MissingFileError, check_arguments
from scoup.field import Field
from scoup.models import Encoder, TextEncoder, words_problem
from scoup.query.answer import Answer, ExpressionAnswer
from scoup.query.ask import answers_of, things_of_question
from scoup.query.catalog import Catalog, make_catalog
from scoup.query.drawings import field_card
from scoup.query.expression import Expression
from scoup.query.field_view import FieldView
from scoup.query.frame import Frame, scene_frame
from scoup.query.labels import GaussianLabels
from scoup.query.question import (
    Question,
    Several,
    check_encoder,
    literal,
    make_question,
    naming_question,
    warn_of_another_model,
)
from scoup.query.relations import relations
from scoup.query.select import Reshaping, select
from scoup.query.things import Place, Thing, all_things, place_of
from scoup.query.view_answer import ViewAnswer
from scoup.scene import Camera, Gaussians
from scoup.uplift import build as uplift_build

Asked = TypeVar("Asked", bound="str | Several | Expression")
Parameters = ParamSpec("Parameters")
_WORDS = (TextEncoder, Mapping, str, Path, type(None))


class LanguageField(Field):
    """A field that answers questions. ``load`` reads one and ``scoup.build`` makes one.

    Methods that ask take a text, or what ``question`` made of texts, and raise the errors of ``question``. One text
    gives one result, a list of texts or vectors a list. A question changes nothing.

    Args:
        words: what encodes texts; by default the word table or model that the field names. It is opened when the first
            text is asked. For vectors, a dict of the canonical phrases ("object", "things", "stuff", "texture") is
            enough.
        others: of ``scoup.field.Field``.

    Raises:
        InputError: ``words`` are of a wrong type; and as of ``scoup.field.Field``.

    Example:
        >>> field = scoup.LanguageField.load("f.scoup")
        >>> field.answer("kettle").level in field.levels
        True
    """

    def __init__(self, *codes: Any, words: Encoder | None = None, **others: Any) -> None:
        super().__init__(*codes, **others)
        check_arguments("LanguageField", words=(words, _WORDS))
        self.words = words
        self._encoder: TextEncoder | None = None  # opened and checked

    @classmethod
    def load(
        cls, path: str | Path, gaussians: Gaussians | None = None, words: Encoder | None = None
    ) -> LanguageField:
        """Read a ``.scoup`` file.

        Args:
            path: the file.
            gaussians: its geometry; by default the one embedded or referenced, loaded when first needed.
            words: what encodes texts; by default what the field names.

        Raises:
            FileFormatError: the file is not a language field, or damaged.
            GeometryMismatchError: ``gaussians`` are not those it was built on.
        """
        check_arguments("LanguageField.load", words=(words, _WORDS))
        return cls._loaded(path, gaussians, words=words)

    @classmethod
    def of(cls, field: Field, words: Encoder | None = None) -> LanguageField:
        """Return a field that shares the tensors of another, and answers questions."""
        check_arguments("LanguageField.of", field=(field, Field), words=(words, _WORDS))
        made = cls(**{**field._arguments(), **({} if words is None else {"words": words})})
        made.path = field.path
        if field.has_geometry:
            made.attach(field.gaussians, known=True)
        return made._like(field)

    def with_encoder(self, words: Encoder) -> LanguageField:
        """Return a field that shares the tensors of this one, and whose texts are encoded by other words."""
        check_arguments("LanguageField.with_encoder", words=(words, _WORDS[:-1]))
        return type(self).of(self, words)

    def _arguments(self) -> dict[str, Any]:
        return {**super()._arguments(), "words": self.words}

    def _like(self, other: Field) -> LanguageField:
        if isinstance(other, LanguageField) and self.words is other.words:
            self._encoder = other._encoder
        return self

    def _repr_html_(self) -> str:
        return field_card(self)

    # ---- words

    @property
    def encoder_source(self) -> str:
        """The word table or model that the field names to encode texts.

        Raises:
            InputError: the field names none.
            MissingFileError: the table is missing.
        """
        words, name = self.info.words, self.path or "this field"
        if words is not None:
            if not words.is_file():
                problem = "is missing, and the field names it as its word table"
                raise MissingFileError(words, problem, "pass its new path as `words`")
            return str(words)
        if not self.embedding_model:
            raise InputError(f"{name}: names no embedding model; pass a word table or model as `words`")
        if problem := words_problem(self.embedding_model):
            raise InputError(f"{name}: {problem}")
        return self.embedding_model

    @property
    def encoder(self) -> TextEncoder:
        """The encoder of texts, opened at its first use and kept.

        Raises:
            InputError: the field names none, or its vectors have another size than the field's embeddings.
            MissingFileError, FileFormatError, ScoupError: it cannot be opened (``TextEncoder.open``).

        Warns:
            ScoupWarning: encoder and field name different models.
        """
        if self._encoder is None:
            source = self.encoder_source if self.words is None else self.words
            if not isinstance(source, TextEncoder):
                source = TextEncoder.open(source, device=self.codebook.device)
            check_encoder(self, source)
            self._encoder = source
        return self._encoder

    def naming_question(self, words: Sequence[str] = ()) -> Question[Any]:
        """Return the question of the words that name things, each as it is; by default all names of the word table, or
        everyday words and the names that a model gave to things."""
        check_arguments("LanguageField.naming_question", words=(words, (list, tuple)))
        return naming_question(self, self.encoder, words)

    # ---- questions

    def question(
        self,
        texts: Asked | Question[Any],
        *,
        always: bool = False,
        present_from: float | None = None,
        threshold: float | None = None,
        level: str | int | None = None,
        frame: Frame | None = None,
    ) -> Question[Asked]:
        """Make a question, which every method of a field takes; texts alone are a question without options.

        Args:
            texts: one, or a list. Each may be a phrase ("mug left of the laptop", "largest box", "what is on the
                table") or an expression ("mug and not handle"); double quotes take a text as it is
                (``scoup.parse_expression``). Or vectors [Q, D] of the field's embedding model, of any norm but zero. A
                question is returned as it is.
            always: find something for any text; presence is not judged.
            present_from: by default 0.35, where there are enough everyday words; see ``Question``.
            threshold, level: see ``Question``.
            frame: what left, front and up mean in phrases; by default ``field.frame()``.

        Raises:
            InputError, UnknownNameError: texts or options do not fit the field, a number is out of range, or the field
                names no encoder.
            MissingFileError, FileFormatError, ScoupError: the encoder cannot be opened (``TextEncoder.open``).

        Warns:
            ScoupWarning: it is a question of another field's model.

        Example:
            >>> field.question("kettle", level="m", always=True).level
            1
        """
        check_arguments(
            "question", frame=(frame, (Frame, type(None))), level=(level, (str, Integral, type(None)))
        )
        if isinstance(texts, Question):
            if always or any(option is not None for option in (present_from, threshold, level, frame)):
                raise InputError("a question has its options; pass them when it is made, or its texts here")
            if texts.queries.shape[1] != self.dim:
                raise InputError(
                    f"a question of {texts.queries.shape[1]} dimensions, but the field contains embeddings of "
                    f"{self.dim}; make it with this field"
                )
            warn_of_another_model(texts.model, self.embedding_model, texts.source)
            return texts
        return make_question(self, self.encoder, texts, always, present_from, threshold, level, frame)

    @overload
    def answer(self, question: str | Question[str]) -> Answer: ...
    @overload
    def answer(self, question: Several | Question[Several]) -> list[Answer]: ...
    def answer(self, question: str | Several | Question[Any]) -> Answer | list[Answer]:
        """Return the answer to a text, decided once in the scene; ``at(camera).answer`` shows it in a view. Phrases and
        expressions have an ``ExpressionAnswer``.

        Example:
            >>> field.answer(field.question("kettle", always=True)).presence
            True
            >>> ", ".join(answer.text for answer in field.answer(["kettle", "wooden table"]))
            'kettle, wooden table'
        """
        asked = self.question(question)
        return asked.shaped(answers_of(self, asked))

    def at(self, camera: Camera | str | int, scale: float = 1.0, backend: str | None = None) -> LanguageView:
        """Return the field as a camera sees it, for several questions: they reuse its projection.

        Args:
            camera: of the view, or its name or position among ``cameras``.
            scale: of the picture, for a quicker look: with 0.25 all is in pixels of a view of a quarter of the width.
            backend: of the rasteriser; by default the best one.

        Raises:
            InputError, UnknownNameError: there is no such camera, or the scale is not above 0.

        Example:
            >>> view = field.at("view_00.png")
            >>> view.answer("kettle").mask.shape, view.relevancy(torch.ones(1, 16), torch.ones(1, 16)).shape
            (torch.Size([30, 40]), torch.Size([3, 1, 30, 40]))
        """
        return LanguageView(self, camera, scale, backend)

    @overload
    def location(self, question: str | Question[str] | Answer) -> Place: ...
    @overload
    def location(self, question: Several | Question[Several]) -> list[Place]: ...
    def location(self, question: str | Several | Question[Any] | Answer) -> Place | list[Place]:
        """Return the place of something in the world: position, oriented box and Gaussians of the best thing.

        It also takes an answer of ``answer``. Its ``position`` is None for what is not there.

        Example:
            >>> field.location(field.question("kettle", always=True)).position.shape
            torch.Size([3])
        """
        if isinstance(question, Answer):
            return place_of(self, question)
        asked = self.question(question)
        return asked.shaped([place_of(self, answer) for answer in answers_of(self, asked)])

    def things(self, question: Question | str | Several | None = None) -> list[Thing]:
        """Return the things of the scene, or every one that answers a text or phrase, best first.

        Args:
            question: a text, phrase or expression, or several of which any may answer; None: every thing, finer levels
                first.

        Returns:
            Things of the field's table; without one, and with a threshold, the connected parts of the selection.

        Example:
            >>> field.things(field.question("kettle", always=True))[0].text
            'kettle'
        """
        if question is None:
            return copy.deepcopy(all_things(self))
        return things_of_question(self, self.question(question))

    def relations(self, frame: Frame | None = None) -> list[tuple[int, str, int]]:
        """Return the things on or inside others of their level: (number, "on" or "inside", number of the other).

        ``frame`` says what up means; by default ``field.frame()``.

        Example:
            >>> {what for _, what, _ in field.relations()} <= {"on", "inside"}
            True
        """
        return relations(self, frame)

    def catalog(self, question: Question | str | Several, frame: Frame | None = None) -> Catalog:
        """Name the things of the scene with several words: an object map, or scene graph. Some have no name.

        ``frame`` says what up means. A field without things raises InputError.

        Example:
            >>> catalog = field.catalog(["kettle", "wooden table"])
            >>> catalog.to_dict()["format"], len(catalog.things) == len(catalog.names)
            ('scoup scene graph', True)
        """
        return copy.deepcopy(make_catalog(self, self.question(literal(question)), frame))

    def frame(self, camera: Camera | str | int | None = None) -> Frame:
        """Return the directions left, front and up of phrases such as "mug left of the laptop".

        Args:
            camera: from which left, right, front and back are meant, or its name or position among ``cameras``; by
                default the camera that sees the most Gaussians.

        Example:
            >>> field.frame("view_00.png").seen_from
            'view_00.png'
        """
        return scene_frame(self, camera)

    def select(
        self, question: Question | str | Several, reshaping: Reshaping | None = None
    ) -> ExpressionAnswer:
        """Return one answer to an expression, such as "mug and not handle"; several are combined with `or`.

        Args:
            question: an expression (``scoup.parse_expression``).
            reshaping: changes the selection afterwards.

        Example:
            >>> found = field.select("kettle and not wooden table")
            >>> found.mask.shape, [part.text for part in found.parts]
            (torch.Size([150]), ['kettle', 'wooden table'])
        """
        if not isinstance(question, (Question, Expression, str, list, tuple)):
            raise InputError(
                f"expected an expression, got {type(question).__name__}; a part of a field is field[mask]"
            )
        check_arguments("select", reshaping=(reshaping, (Reshaping, type(None))))
        return select(self, self.question(question), reshaping)

    def label(self, question: Question | str | Several) -> GaussianLabels:
        """Return the word that fits each Gaussian best, or "none", which cannot be a word itself. Repeated words
        count once.

        Example:
            >>> sorted(field.label(["kettle", "wooden table"]).counts())
            ['kettle', 'none', 'wooden table']
        """
        return GaussianLabels.of(self, answers_of(self, self.question(question)))


class LanguageView(FieldView):
    """A language field as one camera sees it: a ``FieldView`` that takes questions.

    Example:
        >>> view = field.at("view_00.png", scale=0.5)
        >>> {view.answer(text).mask.shape for text in ("kettle", "wooden table")}
        {torch.Size([15, 20])}
    """

    field: LanguageField

    @overload
    def answer(self, question: str | Question[str]) -> ViewAnswer: ...
    @overload
    def answer(self, question: Several | Question[Several]) -> list[ViewAnswer]: ...
    def answer(self, question: str | Several | Question[Any]) -> ViewAnswer | list[ViewAnswer]:
        """Return ``field.answer`` as this view shows it: mask, heat map, box, point."""
        asked = self.field.question(question)
        return asked.shaped(self.show(answers_of(self.field, asked)))


def _with_questions(make: Callable[Parameters, Field]) -> Callable[Parameters, LanguageField]:
    @wraps(make)
    def made(*args: Parameters.args, **options: Parameters.kwargs) -> LanguageField:
        return LanguageField.of(make(*args, **options))

    made.__module__ = __name__  # where pickle finds it
    return made


build = _with_questions(uplift_build)
