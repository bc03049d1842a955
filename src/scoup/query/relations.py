"""The things that a phrase singles out, by its relations and its order."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from scoup.field import Field
from scoup.query.frame import Frame, scene_frame
from scoup.query.phrases import Phrase, Target, texts_of
from scoup.query.relation_rules import AWAY, CONDITIONS, RIGHT, UP, Shapes, touching_things
from scoup.query.things import Thing, all_things

_ENDS = {
    "left": (RIGHT, 1),
    "right": (RIGHT, -1),
    "top": (UP, -1),
    "bottom": (UP, 1),
    "front": (AWAY, 1),
    "back": (AWAY, -1),
}
"""Side that an order counts from -> axis, and the sign with which it counts."""


def resolve(
    field: Field, target: Target, of_texts: Mapping[str, Sequence[Thing]], frame: Frame | None
) -> list[Thing]:
    """Return the things that a text or phrase singles out, in the order of ``of_texts`` or of the phrase.

    Args:
        field: that was asked.
        target: the text or phrase.
        of_texts: the things that answer each of its texts; of "", all objects.
        frame: what right, up and away mean; a text alone needs none.
    """
    if isinstance(target, str) or frame is None:
        return list(of_texts[texts_of(target)[0]])
    things = list(of_texts[target.text])
    anchors = [resolve(field, anchor, of_texts, frame) for anchor in target.anchors]
    if not target.text:
        others = [anchor for group in anchors for anchor in group]
        things = [thing for thing in things if not any(overlaps(thing, other) for other in others)]
    if target.relation:
        things = _related(field, target.relation, things, anchors, frame)
    return _ordered(field, target, things, frame)


def _related(
    field: Field, relation: str, things: list[Thing], anchors: Sequence[list[Thing]], frame: Frame
) -> list[Thing]:
    if not things or not all(anchors):
        return []
    every = [*things, *(thing for group in anchors for thing in group)]
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


def overlaps(one: Thing, other: Thing) -> bool:
    """Return whether one is most of the other, or a part of it."""
    shared = np.intersect1d(one.gaussians, other.gaussians, assume_unique=True)
    return len(shared) > 0.5 * min(one.n_gaussians, other.n_gaussians)


def _same(one: Thing, other: Thing) -> bool:
    return one is other or (one.number is not None and one.number == other.number)


def _ordered(field: Field, phrase: Phrase, things: list[Thing], frame: Frame) -> list[Thing]:
    """Return the one thing of an order and rank; all without an order."""
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


def relations(field: Field, frame: Frame | None = None) -> list[tuple[int, str, int]]:
    """Return the relations between the things of a field; ``LanguageField.relations`` documents it."""
    frame, every = frame or scene_frame(field), all_things(field)
    levels = [[thing for thing in every if thing.level == level] for level in field.levels]
    return [pair for of_level in levels for pair in related_pairs(field, of_level, frame)]


def related_pairs(field: Field, things: Sequence[Thing], frame: Frame) -> Iterator[tuple[int, str, int]]:
    """Yield the things inside or on others: (number, "inside" or "on", number of the other)."""
    shapes = Shapes.of(field, things, frame)
    for one, other, inside, on in touching_things(shapes):
        if inside or on:
            is_inside = inside and (not on or shapes.encloses(other, one))
            yield _number(things[one]), "inside" if is_inside else "on", _number(things[other])


def _number(thing: Thing) -> int:
    assert thing.number is not None
    return thing.number
