"""The queries of a language field as its methods, each in one call."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, overload

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from scoup import raster
from scoup.base.arguments import check_arguments
from scoup.base.errors import InputError, MissingFileError
from scoup.query.answer import Answer, SceneAnswer
from scoup.query.answering import answer_scene, answer_view
from scoup.query.coded_scene import CodedScene
from scoup.query.cosine_cache import versions
from scoup.query.edits import combined_answer
from scoup.query.expression import Expression, parse_expression
from scoup.query.finding import Finding
from scoup.query.label import GaussianLabels, label
from scoup.query.locate import Location, location
from scoup.query.presence import presence_threshold
from scoup.query.presets import QueryPreset, query_preset
from scoup.query.question import Question
from scoup.query.reshape import UNCHANGED, Reshaping
from scoup.query.text_vectors import TextVectors, encode_texts
from scoup.scene.cameras import Camera, Cameras
from scoup.scene.directions import query_vectors

if TYPE_CHECKING:
    from scoup.models.text import TextEncoder

Texts: TypeAlias = "str | Sequence[str] | Tensor | np.ndarray"
"""One text or several, or vectors [D] or [Q, D] in their place."""
MOST_TEXTS = 16  # of a question that is kept
View: TypeAlias = "Camera | str | int"
"""A camera, or its name or position among a field's."""
Encoder: TypeAlias = "TextEncoder | Mapping[str, Tensor | ArrayLike] | str | Path"
"""What turns texts into vectors: an encoder, a dict of name -> vector, a word table's file, or a model by its id."""


class FieldQueries(CodedScene):
    """Methods of a field that answer texts, by the rules of `scoup query` and `scoup select`.

    Attributes:
        tables_folder: where a word table that the field names is sought; that of the field's file.

    All of them compare as `scoup query` does: with the canonical phrases and, by default, with everyday words, which
    also judge whether the thing is there at all.
    """

    tables_folder: Path | None = None
    _encoder: TextEncoder | None = None
    _encoder_name: str = ""  # as it was opened; empty for a dict or an encoder

    @property
    def encoder_source(self) -> str:
        """The model or table to open for texts: a table is sought beside the field's file, as its geometry is.

        Raises:
            InputError: the field names none.
            MissingFileError: the table is not there.
        """
        from scoup.models.word_table import is_table

        name = self.embedding_model
        if not name:
            raise InputError(
                f"{self.path or 'this field'}: names no embedding model; pass encoder=..., a word table, a model id, "
                "or a dict of name -> vector"
            )
        if not is_table(name):
            return name
        beside = Path(name) if self.tables_folder is None else self.tables_folder / name
        found = next((place for place in (beside, Path(name)) if place.is_file()), None)
        if found is None:
            problem = "is not there, and the field names it as its word table"
            raise MissingFileError(beside, problem, "say where it is now (--text, or encoder=... in Python)")
        return str(found)

    def text_encoder(self, encoder: Encoder | None = None) -> TextEncoder:
        """The encoder of this field's texts; opened at its first use and kept.

        Args:
            encoder: to be used from now on; None for the last one, at first the model or table that the field names.

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
            self._questions.clear()
            self._encoder = TextEncoder.open(encoder, device=self.codebook.device)
        self._encoder_name = name
        return self._encoder

    def keep_encoder_of(self, other: FieldQueries) -> None:
        """Use the encoder that another field has open, or would open."""
        self._encoder, self._encoder_name = other._encoder, other._encoder_name
        self.tables_folder = other.tables_folder

    # ---- questions

    def question(  # noqa: PLR0913  the public face: each keyword is one choice of the user
        self,
        texts: Texts | Expression,
        *,
        encoder: Encoder | None = None,
        preset: str | QueryPreset = "default",
        always: bool = False,
        present_from: float | None = None,
        threshold: float | None = None,
        rescaled: bool = True,
        neighbours: int = 0,
        level: str | int | None = None,
    ) -> Question:
        """Make a question, which every method below takes; texts alone are a question without options.

        Args:
            texts: one or several; or vectors [D] or [Q, D] of the field's embedding model, of any norm but zero; or an
                expression (``scoup.parse_expression``), for ``select``.
            encoder: see ``text_encoder``. For vectors, a dict of the canonical phrases ("object", "things", "stuff",
                "texture") will do.
            always: find something for any text; presence is not judged, and ``z_score`` is None.
            preset: its name, or one of ``scoup.query.presets``; see ``Question``.
            present_from: by default 1.4, where there are enough everyday words; see ``Question``.
            threshold, rescaled, neighbours, level: see ``Question``.

        Raises:
            InputError, UnknownNameError: texts or options do not fit the field, a number is out of range, or the field
                names no encoder.
            MissingFileError, FileFormatError, ScoupError: the encoder cannot be opened (``TextEncoder.open``).

        Example:
            >>> field.question("kettle", level="m", always=True).level
            1
        """
        check_arguments("question", preset=(preset, (str, QueryPreset)))
        source = self.text_encoder(encoder)
        key = _key(texts, source, preset, always, present_from, threshold, rescaled, neighbours, level)
        known = None if key is None else self._questions.get(key)
        if known is not None:
            return known
        preset = query_preset(preset) if isinstance(preset, str) else preset
        if threshold is not None:
            preset = replace(preset, threshold=threshold)
        expression = texts if isinstance(texts, Expression) else None
        words = list(texts.texts) if isinstance(texts, Expression) else texts
        vectors = self._vectors(words)
        everyday = preset.name == "default"
        judged = not always and (everyday or present_from is not None)
        question = Question.from_vectors(
            vectors.with_everyday() if everyday else vectors,
            preset=preset,
            threshold=threshold,
            present_from=presence_threshold(vectors, present_from) if judged else None,
            is_single=_is_single(words),
            expression=expression,
            rescaled=rescaled,
            neighbours=neighbours,
            level=None if level is None else self.level_index(level),
        )
        if key is not None:
            self._questions.keep(
                key, question, sum(each.nbytes for each in (question.queries, question.canonical))
            )
        return question

    def _vectors(self, texts: Texts) -> TextVectors:
        """The vectors of texts, or vectors as they are, with what they are compared with."""
        words = [texts] if isinstance(texts, str) else texts
        if isinstance(words, (list, tuple)) and all(isinstance(word, str) for word in words):
            if not words:
                raise InputError('give at least one text to look for, for example "kettle"')
            return encode_texts(self.text_encoder(), self, words, self._encoder_name)
        queries = query_vectors(_as_vectors(texts), self.dim)
        names = tuple(f"query {number}" for number in range(1, len(queries) + 1))
        compared = encode_texts(self.text_encoder(), self, [], self._encoder_name)
        return replace(compared, texts=names, queries=queries)

    def _asked(self, question: Question | Texts) -> Question:
        return question if isinstance(question, Question) else self.question(question)

    # ---- answers

    @overload
    def answer(
        self,
        question: str,
        camera: View = 0,
        *,
        projection: raster.Projection | None = None,
        scale: float = 1.0,
    ) -> Answer: ...
    @overload
    def answer(
        self,
        question: Question | Texts,
        camera: View = 0,
        *,
        projection: raster.Projection | None = None,
        scale: float = 1.0,
    ) -> Any: ...
    def answer(
        self,
        question: Question | Texts,
        camera: View = 0,
        *,
        projection: raster.Projection | None = None,
        scale: float = 1.0,
    ) -> Answer | list[Answer]:
        """Return where something is in one view: mask, heat map, box, point, presence.

        Args:
            question: from ``question``, or texts.
            camera: of the view, or its name or position among ``cameras``.
            projection: what ``field.project(camera)`` returned, if it is known: further questions with it take less
                time.
            scale: of the picture, for a quicker look: with 0.25 all is in pixels of a view of a quarter of the width.

        Returns:
            An answer, or one for each of several texts or vectors.

        Raises:
            InputError, UnknownNameError: as ``question``, or there is no such camera.

        Example:
            >>> answer = field.answer(field.question("kettle", always=True), "view_00.png")
            >>> answer.presence, answer.mask.shape
            (True, torch.Size([30, 40]))
        """
        question = self._asked(question)
        if scale != 1.0:
            camera = Cameras([self.camera(camera)]).scaled(scale)[0]
        answers = answer_view(self, camera, question, projection)
        return answers[0] if question.is_single else answers

    @overload
    def location(self, question: str | SceneAnswer) -> Location: ...
    @overload
    def location(self, question: Question | Texts) -> Any: ...
    def location(self, question: Question | Texts | SceneAnswer) -> Location | list[Location]:
        """Return where something is in the world: position, oriented box, confidence, and the Gaussians.

        Args:
            question: from ``question``, or texts; or an answer of ``select``.

        Returns:
            A location, or one for each of several texts or vectors. One whose ``position`` is None is not there.

        Raises:
            InputError, UnknownNameError: as ``question``.

        Example:
            >>> field.location(field.question("kettle", always=True)).position.shape
            torch.Size([3])
        """
        if isinstance(question, SceneAnswer):
            return location(self, question)
        asked = self._asked(question)
        found = self._recent(
            (asked, Location), lambda: [location(self, answer) for answer in answer_scene(self, asked)]
        )
        return found[0] if asked.is_single else found

    @overload
    def finding(self, question: str, cameras: Iterable[View] | None = None) -> Finding: ...
    @overload
    def finding(self, question: Question | Texts, cameras: Iterable[View] | None = None) -> Any: ...
    def finding(
        self, question: Question | Texts, cameras: Iterable[View] | None = None
    ) -> Finding | list[Finding]:
        """Return where something is in the views of several cameras and in the world: all that `scoup query` says.

        Args:
            question: from ``question``, or texts.
            cameras: of the views, or their names or positions among ``cameras``; by default all of those.

        Returns:
            A finding, or one for each of several texts or vectors.

        Raises:
            InputError, UnknownNameError: as ``answer``.

        Example:
            >>> found = field.finding(field.question("kettle", always=True), ["view_00.png"])
            >>> found.presence, found.best.view
            (True, 'view_00.png')
        """
        question = self._asked(question)
        views = self.cameras or () if cameras is None else cameras
        answers = [answer_view(self, camera, question) for camera in views]
        found = [
            Finding(answer.text, tuple(of_view[number] for of_view in answers), location(self, answer))
            for number, answer in enumerate(answer_scene(self, question))
        ]
        return found[0] if question.is_single else found

    def select(
        self, question: Question | str | Sequence[str], reshaping: Reshaping = UNCHANGED
    ) -> SceneAnswer:
        """Return the Gaussians that answer an expression over texts, such as "mug and not handle".

        Args:
            question: an expression (``scoup.parse_expression``), or what ``question`` made of one. Of several texts
                any may answer.
            reshaping: what is done to the selection afterwards.

        Returns:
            One answer, with those to its texts as ``parts``.

        Raises:
            InputError, UnknownNameError: it is not an expression, or as ``question``.

        Example:
            >>> found = field.select("kettle and not wooden table")
            >>> found.mask.shape, [part.text for part in found.parts]
            (torch.Size([150]), ['kettle', 'wooden table'])
        """
        check_arguments("select", reshaping=(reshaping, Reshaping))
        if not isinstance(question, Question):
            words = [question] if isinstance(question, str) else question
            if not isinstance(words, (list, tuple)) or not all(isinstance(word, str) for word in words):
                raise InputError(
                    f"select: expected an expression, got {type(question).__name__}; a part of a field is field[mask]"
                )
            question = self.question(parse_expression(words))
        expression, asked = question.expression or Expression.of(question.texts), question
        return self._recent(
            (asked, reshaping),
            lambda: [combined_answer(self, expression, answer_scene(self, asked), reshaping)],
        )[0]

    def label(self, question: Question | Texts) -> GaussianLabels:
        """Return the word that fits each Gaussian best, of several, or none of them.

        Args:
            question: from ``question``, or words: names of things.

        Raises:
            InputError, UnknownNameError: as ``question``, or a word is given twice or is "none".

        Example:
            >>> sorted(field.label(["kettle", "wooden table"]).counts())
            ['kettle', 'none', 'wooden table']
        """
        return label(self, self._asked(question))

    def _recent(self, key: tuple[Any, ...], make: Callable[[], list[Any]]) -> list[Any]:
        """A copy of what was answered to the same question a short while ago; else what ``make`` returns."""
        parts = self._parts()  # kept with the answer, so that no other part can get the id of one
        key = (*key, *versions(*parts))
        known = self._answers.get(key)
        if known is None:
            found = make()
            known = found, parts
            self._answers.keep(key, known, sum(map(_bytes, found)))
        return copy.deepcopy(known[0])


def _key(texts: Any, *options: Any) -> tuple[Any, ...] | None:
    """What tells questions apart; None for vectors, and for many texts, whose questions are not kept."""
    words = tuple(texts) if isinstance(texts, (list, tuple)) else texts
    key = type(texts), words, *options
    try:
        hash(key)
    except TypeError:
        return None
    is_text = isinstance(words, (str, Expression))
    is_text = is_text or (
        isinstance(words, tuple) and len(words) <= MOST_TEXTS and all(isinstance(word, str) for word in words)
    )
    return key if is_text else None


def _bytes(answer: Any) -> int:
    """Of the tensors of an answer and of those within."""
    if isinstance(answer, Tensor):
        return answer.nbytes
    if isinstance(answer, tuple):
        return sum(map(_bytes, answer))
    return sum(map(_bytes, vars(answer).values())) if isinstance(answer, (Location, SceneAnswer)) else 0


def _is_single(texts: Texts) -> bool:
    """Whether they are one text, or one vector."""
    if isinstance(texts, (list, tuple)) and any(isinstance(text, str) for text in texts):
        return False
    return isinstance(texts, str) or _as_vectors(texts).dim() == 1


def _as_vectors(texts: Texts) -> Tensor:
    """Vectors in the place of texts."""
    try:
        vectors = torch.as_tensor(texts)
    except (TypeError, ValueError, RuntimeError):
        vectors = torch.empty(())
    if not vectors.dim():
        raise InputError(
            f"expected a text, a list of texts, or vectors [D] or [Q, D], got {type(texts).__name__} {str(texts)[:60]}"
        )
    return vectors
