"""Which things a phrase singles out, by its relations and its order."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from scoup.field.language_field import LanguageField
from scoup.query.answer import Answer
from scoup.query.answer_scene import answers_of
from scoup.query.expression import Expression
from scoup.query.frame import Frame, scene_frame
from scoup.query.phrases import Phrase, Target, counted_text, texts_of
from scoup.query.question import Question, Several, as_expression
from scoup.query.relation_rules import AWAY, CONDITIONS, CONTACT, RIGHT, UP, Shapes
from scoup.query.things import Thing, all_things, things_of_answer

_ENDS = {
    "left": (RIGHT, 1),
    "right": (RIGHT, -1),
    "top": (UP, -1),
    "bottom": (UP, 1),
    "front": (AWAY, 1),
    "back": (AWAY, -1),
}
"""Side that an order counts from -> axis, and the sign with which it counts."""


def things(
    field: LanguageField, question: Question[Any] | str | Several | None, frame: Frame | None
) -> list[Thing]:
    """Return all things, or those that a question singles out; ``field.things`` documents it."""
    if question is None:
        return copy.deepcopy(field.kept(Thing, lambda: all_things(field)))
    text = counted_text(question) if isinstance(question, str) else None
    asked, counted = as_expression(field, question if text is None else text), text is not None

    def made() -> list[Thing]:
        return things_of_question(field, asked, answers_of(field, asked), frame, counted)

    return copy.deepcopy(field.kept((Thing, asked, frame, counted), made))


def resolve(
    field: LanguageField, target: Target, of_texts: Mapping[str, Sequence[Thing]], frame: Frame | None
) -> list[Thing]:
    """Return the things that a text or phrase singles out, in the order of ``of_texts`` or of the phrase.

    Args:
        field: that was asked.
        target: the text or phrase.
        of_texts: the things that answer each of its texts.
        frame: what right, up and away mean; a text alone needs none.
    """
    if isinstance(target, str) or frame is None:
        return list(of_texts[texts_of(target)[0]])
    things = list(of_texts[target.text])
    if target.relation:
        anchors = [resolve(field, anchor, of_texts, frame) for anchor in target.anchors]
        things = _related(field, target.relation, things, anchors, frame)
    return _ordered(field, target, things, frame)


def things_of_question(
    field: LanguageField,
    question: Question,
    answers: Sequence[Answer],
    frame: Frame | None = None,
    counted: bool = False,
) -> list[Thing]:
    """Return every thing that one of the texts or phrases of a question singles out, best first, each once.

    Args:
        field: that was asked.
        question: from ``field.question``; a text or phrase, or several joined by "or".
        answers: to its texts, from ``answer_scene``.
        frame: what right, up and away mean; by default ``scene_frame``.
        counted: return the things that are one instance each, to be counted.
    """
    expression = question.expression or Expression.of(question.texts)
    things = [
        thing for each in _resolved(field, expression.targets, answers, frame, counted) for thing in each
    ]
    first: dict[int, Thing] = {}
    for thing in things:
        first.setdefault(id(thing) if thing.number is None else thing.number, thing)
    return list(first.values())


def phrase_masks(
    field: LanguageField, question: Question, answers: Sequence[Answer], frame: Frame | None = None
) -> dict[str, Tensor]:
    """Return the Gaussians [N] boolean of each phrase of an expression; arguments as ``things_of_question``."""
    phrases = question.expression.phrases if question.expression else ()
    masks = {str(phrase): torch.zeros(len(field), dtype=torch.bool) for phrase in phrases}
    for mask, things in zip(masks.values(), _resolved(field, phrases, answers, frame), strict=True):
        for thing in things:
            mask[thing.gaussians] = True
    return masks


def _resolved(
    field: LanguageField,
    targets: Sequence[Target],
    answers: Sequence[Answer],
    frame: Frame | None,
    counted: bool = False,
) -> list[list[Thing]]:
    if not targets:
        return []
    of_texts = {answer.text: things_of_answer(field, answer, counted) for answer in answers}
    related = any(isinstance(target, Phrase) for target in targets)
    frame = scene_frame(field) if frame is None and related else frame
    return [resolve(field, target, of_texts, frame) for target in targets]


def _related(
    field: LanguageField, relation: str, things: list[Thing], anchors: Sequence[list[Thing]], frame: Frame
) -> list[Thing]:
    if not things or not all(anchors):
        return []
    every = [*things, *(thing for each in anchors for thing in each)]
    shapes = Shapes.of(field, every, frame)
    starts = np.cumsum([len(things), *map(len, anchors)])
    first = range(starts[0], starts[1])
    if relation == "nearest to":
        distances = [
            (shapes.gap(one, other), float(np.linalg.norm(shapes.middle(one) - shapes.middle(other))), one)
            for one in range(len(things))
            for other in first
            if not _same(things[one], every[other])
        ]
        return [things[min(distances)[2]]] if distances else []
    pairs = [(other,) for other in first]
    if relation == "between":
        pairs = [(one, other) for one in first for other in range(starts[1], starts[2]) if one != other]
    condition = CONDITIONS[relation]
    return [
        thing
        for number, thing in enumerate(things)
        if any(
            condition(shapes, number, others)
            for others in pairs
            if not any(_same(thing, every[other]) for other in others)
        )
    ]


def _same(one: Thing, other: Thing) -> bool:
    return one is other or (one.number is not None and one.number == other.number)


def _ordered(field: LanguageField, phrase: Phrase, things: list[Thing], frame: Frame) -> list[Thing]:
    """The one thing of an order and rank; all without an order."""
    if not phrase.order or not things:
        return things
    if phrase.order in _ENDS:
        axis, sign = _ENDS[phrase.order]
        shapes = Shapes.of(field, things, frame)
        keys = [sign * float(shapes.middle(number)[axis]) for number in range(len(things))]
    else:
        keys = [(-1 if phrase.order == "largest" else 1) * thing.size for thing in things]
    order = sorted(range(len(things)), key=keys.__getitem__)
    return [things[order[phrase.rank - 1]]] if phrase.rank <= len(things) else []


def relations(field: LanguageField, frame: Frame | None = None) -> list[tuple[int, str, int]]:
    """Return how the things of a field stand to each other; ``field.relations`` documents it."""
    frame, every = scene_frame(field) if frame is None else frame, things(field, None, None)
    levels = [[thing for thing in every if thing.level == level] for level in field.levels]
    return [pair for of_level in levels for pair in related_pairs(field, of_level, frame)]


def related_pairs(
    field: LanguageField, things: Sequence[Thing], frame: Frame
) -> Iterator[tuple[int, str, int]]:
    """Yield which things are inside or on which others: (number, "inside" or "on", number of the other)."""
    shapes = Shapes.of(field, things, frame)
    low, high = shapes.spans[..., 0], shapes.spans[..., 1]
    heights = (high - low)[:, UP]
    for one, thing in enumerate(things):
        gaps = np.maximum(low[one], low) - np.minimum(high[one], high)
        for other in np.flatnonzero((gaps <= CONTACT * heights[one]).all(1)).tolist():
            if other == one:
                continue
            inside, on = (CONDITIONS[what](shapes, one, (other,)) for what in ("inside", "on"))
            if inside or on:
                is_inside = inside and (not on or shapes.encloses(other, one))
                yield _number(thing), "inside" if is_inside else "on", _number(things[other])


def _number(thing: Thing) -> int:
    assert thing.number is not None
    return thing.number
