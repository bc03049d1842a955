"""The questions that a language field answers, each as one method."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from typing import Any, TypeAlias, overload

from torch import Tensor

from scoup import raster
from scoup.base.arguments import check_arguments
from scoup.base.errors import InputError
from scoup.query.answer import Answer, ViewAnswer
from scoup.query.answering import answer_scene, draw_answers
from scoup.query.asking import AskedScene, Texts
from scoup.query.catalog import Catalog, make_catalog
from scoup.query.cosines import versions
from scoup.query.edits import combined_answer
from scoup.query.expression import Expression, parse_expression
from scoup.query.frame import Frame, scene_frame
from scoup.query.label import GaussianLabels, label
from scoup.query.phrases import counted_text
from scoup.query.place import Place, place_of
from scoup.query.question import Question
from scoup.query.relations import phrase_masks, things_of_question
from scoup.query.reshape import UNCHANGED, Reshaping
from scoup.query.scene_things import Thing, all_things
from scoup.scene.cameras import Camera

View: TypeAlias = "Camera | str | int"
"""A camera, or its name or position among a field's."""


class FieldQueries(AskedScene):
    """Methods of a field that answer texts, by the rules of `scoup query` and `scoup select`.

    All of them compare with the canonical phrases and, by default, with everyday words, which also judge whether the
    thing is there at all.
    """

    def _asked(self, question: Question | Texts) -> Question:
        return question if isinstance(question, Question) else self.question(question)

    @overload
    def answer(self, question: str) -> Answer: ...
    @overload
    def answer(
        self,
        question: str,
        camera: View,
        *,
        projection: raster.Projection | None = None,
        scale: float = 1.0,
    ) -> ViewAnswer: ...
    @overload
    def answer(
        self,
        question: Question | Texts,
        camera: View | None = None,
        *,
        projection: raster.Projection | None = None,
        scale: float = 1.0,
    ) -> Any: ...
    def answer(
        self,
        question: Question | Texts,
        camera: View | None = None,
        *,
        projection: raster.Projection | None = None,
        scale: float = 1.0,
    ) -> Answer | ViewAnswer | list[Answer] | list[ViewAnswer]:
        """Return what answers a text, decided once in the scene; with a camera, as its view shows it.

        Args:
            question: from ``question``, or texts.
            camera: of the view, or its name or position among ``cameras``; None: the answer of the scene itself.
            projection: what ``field.project(camera)`` returned; further questions with it take less time.
            scale: of the picture, for a quicker look: with 0.25 all is in pixels of a view of a quarter of the width.

        Returns:
            An answer, or a list of them for several texts or vectors. In a view: mask, heat map, box, point.

        Raises:
            InputError, UnknownNameError: as ``question``, or there is no such camera.

        Example:
            >>> question = field.question("kettle", always=True)
            >>> field.answer(question).presence, field.answer(question, "view_00.png").mask.shape
            (True, torch.Size([30, 40]))
        """
        asked = self._asked(question)
        answers = self._scene_answers(asked)
        if camera is not None:
            answers = draw_answers(self, answers, camera, projection, scale)
        return answers[0] if asked.is_single else answers

    @overload
    def location(self, question: str | Answer) -> Place: ...
    @overload
    def location(self, question: Question | Texts) -> Any: ...
    def location(self, question: Question | Texts | Answer) -> Place | list[Place]:
        """Return where something is in the world: the position, oriented box and Gaussians of the best thing.

        Args:
            question: from ``question``, or texts; or an answer of ``answer``.

        Returns:
            A place, or a list of them for several texts or vectors; ``position`` is None for what is not there.

        Raises:
            InputError, UnknownNameError: as ``question``.

        Example:
            >>> field.location(field.question("kettle", always=True)).position.shape
            torch.Size([3])
        """
        if isinstance(question, Answer):
            return place_of(self, question)
        asked = self._asked(question)
        found = self._recent(
            (asked, Place), lambda: [place_of(self, answer) for answer in self._scene_answers(asked)]
        )
        return found[0] if asked.is_single else found

    def things(
        self, question: Question | str | Sequence[str] | None = None, frame: Frame | None = None
    ) -> list[Thing]:
        """Return the things of the scene, or every one that answers a text or phrase, best first.

        Args:
            question: a text ("mug"), a phrase ("mug left of the laptop", "largest box", "second chair from the left",
                "how many cups": ``scoup.query.phrases``), several of them combined with `or`, or what ``question``
                made of them. None: every thing, finer levels first.
            frame: what left, front and up mean in phrases; by default ``field.frame()``.

        Returns:
            Things of the field's table; in a field without it, and where a threshold of choice says how the votes are
            read, the connected parts of the selection. Empty where the text is not in the scene.

        Raises:
            InputError, UnknownNameError: as ``question``, or a relation is not known.

        Example:
            >>> field.things(field.question("kettle", always=True))[0].text
            'kettle'
        """
        if question is None:
            return self._recent(("things",), lambda: all_things(self))
        to_count = counted_text(question) if isinstance(question, str) else None
        counted = to_count is not None
        asked = self._asked_expression(self._singular(to_count) if to_count else question)
        return self._recent(
            (asked, frame, Thing, counted),
            lambda: things_of_question(self, asked, self._scene_answers(asked), frame, counted),
        )

    def catalog(self, question: Question | Texts, frame: Frame | None = None) -> Catalog:
        """Name every thing of the scene with the best of several words: an object map, or scene graph.

        Args:
            question: from ``question``, or words.
            frame: what up means; by default ``field.frame()``.

        Raises:
            InputError, UnknownNameError: as ``question``, or the field has no things.

        Example:
            >>> catalog = field.catalog(["kettle", "wooden table"])
            >>> catalog.record()["format"], len(catalog.things) == len(catalog.names)
            ('scoup scene graph', True)
        """
        return make_catalog(self, self._asked(question), frame)

    def frame(self, camera: View | None = None, up: Sequence[float] | None = None) -> Frame:
        """Return what left, front and up mean in phrases such as "mug left of the laptop".

        Args:
            camera: from which left, right, front and back are meant, or its name or position among ``cameras``; by
                default the camera that sees the most Gaussians.
            up: world direction; by default estimated from the cameras, which people hold level.

        Raises:
            InputError, UnknownNameError: there is no such camera, or ``up`` is not a direction.

        Example:
            >>> field.frame("view_00.png").seen_from
            'view_00.png'
        """
        return scene_frame(self, camera, up)

    def select(
        self,
        question: Question | str | Sequence[str],
        reshaping: Reshaping = UNCHANGED,
        frame: Frame | None = None,
    ) -> Answer:
        """Return the Gaussians that answer an expression, such as "mug and not handle" or "mug left of the laptop".

        Args:
            question: an expression (``scoup.parse_expression``), or what ``question`` made of one. Texts without an
                operator are combined with `or`.
            reshaping: changes the selection afterwards.
            frame: what left, front and up mean in phrases; by default ``field.frame()``.

        Returns:
            One answer; its ``parts`` are the answers to its texts.

        Raises:
            InputError, UnknownNameError: as ``question``, or it is not an expression.

        Example:
            >>> found = field.select("kettle and not wooden table")
            >>> found.mask.shape, [part.text for part in found.parts]
            (torch.Size([150]), ['kettle', 'wooden table'])
        """
        check_arguments("select", reshaping=(reshaping, Reshaping))
        asked = self._asked_expression(question)

        def selected() -> list[Answer]:
            expression, answers = asked.expression or Expression.of(asked.texts), self._scene_answers(asked)
            phrases = phrase_masks(self, asked, answers, frame)
            return [combined_answer(self, expression, answers, reshaping, phrases)]

        return self._recent((asked, reshaping, frame), selected)[0]

    def label(self, question: Question | Texts) -> GaussianLabels:
        """Return the word that fits each Gaussian best, or "none".

        Args:
            question: from ``question``, or words: names of things.

        Raises:
            InputError, UnknownNameError: as ``question``, or a word is given twice or is "none".

        Example:
            >>> sorted(field.label(["kettle", "wooden table"]).counts())
            ['kettle', 'none', 'wooden table']
        """
        return label(self, self._asked(question))

    def _scene_answers(self, asked: Question) -> list[Answer]:
        return self._recent((asked, Answer), lambda: answer_scene(self, asked))

    def _asked_expression(self, question: Question | str | Sequence[str]) -> Question:
        if isinstance(question, Question):
            return question
        words = [question] if isinstance(question, str) else question
        if not isinstance(words, (list, tuple)) or not all(isinstance(word, str) for word in words):
            raise InputError(
                f"expected an expression, got {type(question).__name__}; a part of a field is field[mask]"
            )
        return self.question(parse_expression(words))

    def _singular(self, text: str) -> str:
        """Return a text of which several are counted in the form that the words of a table have."""
        known = self.text_encoder().names
        if not known or text in known:
            return text
        forms = (text.removesuffix("s"), text.removesuffix("es"), f"{text.removesuffix('ies')}y")
        return next((form for form in forms if form in known), text)

    def _recent(self, key: tuple[Any, ...], make: Callable[[], list[Any]]) -> list[Any]:
        """Return a copy of the answers kept for the same question, or make them."""
        parts = self._parts()  # kept with the answers, so that no other part can get the id of one
        key = (*key, *versions(*parts))
        known = self.recent.get(key)
        if known is None:
            known = make(), parts
            self.recent.keep(key, known, sum(map(_bytes, known[0])))
        return copy.deepcopy(known[0])


def _bytes(answer: Any) -> int:
    """Bytes of the tensors of an answer and of those within."""
    if isinstance(answer, Tensor):
        return answer.nbytes
    if isinstance(answer, tuple):
        return sum(map(_bytes, answer))
    if isinstance(answer, Place):
        return _bytes(answer.answer) + _bytes(answer.thing)
    if isinstance(answer, Answer):
        return _bytes(answer.mask) + _bytes(answer.parts)
    return sum(map(_bytes, vars(answer).values())) if isinstance(answer, Thing) else 0
