"""Which things a phrase singles out: relations between things, measured along the directions of a frame.

Spans along right, up and away (``ThingPoints.spans``) stand for things; contact for "on" is measured from the
Gaussians below. The rules are ours; `python -m benchmarks things` measures them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from scoup.query.answer import SceneAnswer
from scoup.query.coded_scene import CodedScene
from scoup.query.expression import Expression
from scoup.query.frame import Frame, scene_frame
from scoup.query.phrases import Phrase, Target, texts_of
from scoup.query.question import Question
from scoup.query.scene_things import Thing, things_of_answer
from scoup.query.thing_shapes import ThingPoints

RIGHT, UP, AWAY = range(3)
CLEAR = 0.5
"""One thing is left of another if its middle lies beyond this share of half the other's extent."""
OVER = 0.5
"""Share of a thing's footprint that must lie over another for it to be on or inside it."""
OVER_PART = 0.25
"""Share of one of two footprints that must lie over the other for the upper thing to be above the lower."""
CONTACT = 0.35
"""Largest gap between the bottom of a thing and what it is on, in units of its height."""
SECTORS, SURROUNDED = 8, 0.75
"""A thing contains another only if it has Gaussians in this share of so many directions around it."""
NEAR = 0.5
"""Things are near each other if the gap between them is at most this share of the larger one's diagonal."""
BETWEEN = (0.15, 0.85, 0.5)
"""A thing is between two others if its place along the line between them lies within the first two, and its distance
from that line is at most this share of their distance."""

Array = NDArray[np.float64]
Condition = Callable[["_Shapes", int, tuple[int, ...]], bool]


@dataclass(frozen=True, eq=False)
class _Shapes:
    """Things along the axes of a frame: right, up, away."""

    things: Sequence[Thing]
    points: ThingPoints  # in the frame's axes
    spans: Array  # [T, 3, 2]

    @classmethod
    def of(cls, field: CodedScene, things: Sequence[Thing], frame: Frame) -> _Shapes:
        points = ThingPoints.of(field.gaussians, [thing.gaussians for thing in things])
        points = replace(points, means=points.means @ frame.axes.numpy().T)
        return cls(things, points, points.spans(frame.axes.new_ones(3).diag()))

    def middle(self, number: int) -> Array:
        return self.spans[number].mean(1)

    def extent(self, number: int) -> Array:
        return self.spans[number, :, 1] - self.spans[number, :, 0]

    def gap(self, one: int, other: int) -> float:
        """Distance between the spans of two things; 0 where they overlap."""
        low = np.maximum(self.spans[one, :, 0], self.spans[other, :, 0])
        high = np.minimum(self.spans[one, :, 1], self.spans[other, :, 1])
        return float(np.linalg.norm((low - high).clip(min=0)))

    def overlap(self, one: int, other: int) -> float:
        """The share of one thing's footprint that lies over another's."""
        share = 1.0
        for axis in (RIGHT, AWAY):
            low = max(self.spans[one, axis, 0], self.spans[other, axis, 0])
            high = min(self.spans[one, axis, 1], self.spans[other, axis, 1])
            share *= max(0.0, high - low) / max(self.spans[one, axis, 1] - self.spans[one, axis, 0], 1e-9)
        return share

    def top_below(self, one: int, other: int) -> float:
        """How high another thing reaches around the footprint of one, not above its middle; minus infinity if it is
        not there."""
        means, _ = self.points.of_one(other)
        margin = 0.5 * self.extent(one)
        around = np.ones(len(means), bool)
        for axis in (RIGHT, AWAY):
            low, high = self.spans[one, axis, 0] - margin[axis], self.spans[one, axis, 1] + margin[axis]
            around &= (means[:, axis] >= low) & (means[:, axis] <= high)
        heights = means[around, UP]
        heights = heights[heights <= self.middle(one)[UP]]
        return float(np.quantile(heights, 0.9)) if len(heights) else -np.inf

    def surrounds(self, one: int, other: int) -> bool:
        """Whether a thing has Gaussians on nearly all sides of another, at the heights of the other."""
        means, _ = self.points.of_one(one)
        low, high = self.spans[other, UP]
        away = means[(means[:, UP] >= low) & (means[:, UP] <= high)] - self.middle(other)
        sectors = np.floor((np.arctan2(away[:, AWAY], away[:, RIGHT]) / np.pi + 1) / 2 * SECTORS).astype(int)
        counts = np.bincount(sectors.clip(0, SECTORS - 1), minlength=SECTORS)
        return bool((counts > 0).mean() >= SURROUNDED)


def _beyond(axis: int, sign: int) -> Condition:
    """Whether the middle of one lies clearly on one side of another along an axis."""

    def holds(shapes: _Shapes, one: int, others: tuple[int, ...]) -> bool:
        offset = sign * (shapes.middle(one)[axis] - shapes.middle(others[0])[axis])
        return bool(offset > CLEAR * 0.5 * shapes.extent(others[0])[axis])

    return holds


def _on(shapes: _Shapes, one: int, others: tuple[int, ...]) -> bool:
    if shapes.overlap(one, others[0]) < OVER:
        return False
    gap = shapes.spans[one, UP, 0] - shapes.top_below(one, others[0])
    return bool(abs(gap) <= CONTACT * shapes.extent(one)[UP])


def _above(shapes: _Shapes, one: int, others: tuple[int, ...]) -> bool:
    other = others[0]
    over = max(shapes.overlap(one, other), shapes.overlap(other, one))
    height = shapes.extent(one)[UP]
    clear = shapes.spans[one, UP, 0] >= shapes.spans[other, UP, 1] - CONTACT * height
    return bool(over >= OVER_PART and (clear or _on(shapes, one, others)))


def _under(shapes: _Shapes, one: int, others: tuple[int, ...]) -> bool:
    return _above(shapes, others[0], (one,))


def _inside(shapes: _Shapes, one: int, others: tuple[int, ...]) -> bool:
    other = others[0]
    if shapes.overlap(one, other) < OVER or shapes.extent(one).prod() >= shapes.extent(other).prod():
        return False
    low, high = shapes.spans[one, UP]
    within = min(high, shapes.spans[other, UP, 1]) - max(low, shapes.spans[other, UP, 0])
    return bool(within > CONTACT * (high - low) and shapes.surrounds(other, one))


def _near(shapes: _Shapes, one: int, others: tuple[int, ...]) -> bool:
    larger = max(np.linalg.norm(shapes.extent(one)), np.linalg.norm(shapes.extent(others[0])))
    return bool(shapes.gap(one, others[0]) <= NEAR * larger)


def _between(shapes: _Shapes, one: int, others: tuple[int, ...]) -> bool:
    start, end = shapes.middle(others[0]), shapes.middle(others[1])
    line, own = end - start, shapes.middle(one) - start
    length = float(np.linalg.norm(line))
    if length <= 0:
        return False
    place = float(own @ line) / length**2
    low, high, aside = BETWEEN
    return bool(low <= place <= high and np.linalg.norm(own - place * line) <= aside * length)


CONDITIONS: Mapping[str, Condition] = {
    "left of": _beyond(RIGHT, -1),
    "right of": _beyond(RIGHT, 1),
    "in front of": _beyond(AWAY, -1),
    "behind": _beyond(AWAY, 1),
    "on": _on,
    "above": _above,
    "under": _under,
    "between": _between,
    "near": _near,
    "inside": _inside,
}
"""Every relation but "nearest to", which compares the things with each other."""
_ENDS = {
    "left": (RIGHT, 1),
    "right": (RIGHT, -1),
    "top": (UP, -1),
    "bottom": (UP, 1),
    "front": (AWAY, 1),
    "back": (AWAY, -1),
}


def holds(field: CodedScene, relation: str, one: Thing, others: Sequence[Thing], frame: Frame) -> bool:
    """Return whether a relation holds between a thing and another (for "between" two others)."""
    shapes = _Shapes.of(field, [one, *others], frame)
    return CONDITIONS[relation](shapes, 0, tuple(range(1, len(shapes.things))))


def resolve(
    field: CodedScene, target: Target, of_texts: Mapping[str, Sequence[Thing]], frame: Frame | None
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
    found = list(of_texts[target.text])
    if target.relation:
        anchors = [resolve(field, anchor, of_texts, frame) for anchor in target.anchors]
        found = _related(field, target.relation, found, anchors, frame)
    return _ordered(field, target, found, frame)


def things_of_question(
    field: CodedScene, question: Question, answers: Sequence[SceneAnswer], frame: Frame | None = None
) -> list[Thing]:
    """Return every thing that one of the texts or phrases of a question singles out, best first, each once.

    Args:
        field: that was asked.
        question: from ``field.question``; a text or phrase, or several joined by "or".
        answers: to its texts, from ``answer_scene``.
        frame: what right, up and away mean; by default ``scene_frame``.
    """
    expression = question.expression or Expression.of(question.texts)
    found = [
        thing for each in _resolved(field, question, expression.targets, answers, frame) for thing in each
    ]
    first: dict[int, Thing] = {}
    for thing in found:
        first.setdefault(id(thing) if thing.number is None else thing.number, thing)
    return list(first.values())


def phrase_masks(
    field: CodedScene, question: Question, answers: Sequence[SceneAnswer], frame: Frame | None = None
) -> dict[str, Tensor]:
    """Return the Gaussians [N] boolean of each phrase of an expression; arguments as ``things_of_question``."""
    phrases = question.expression.phrases if question.expression else ()
    masks = {str(phrase): torch.zeros(len(field), dtype=torch.bool) for phrase in phrases}
    for mask, things in zip(masks.values(), _resolved(field, question, phrases, answers, frame), strict=True):
        for thing in things:
            mask[thing.gaussians] = True
    return masks


def _resolved(
    field: CodedScene,
    question: Question,
    targets: Sequence[Target],
    answers: Sequence[SceneAnswer],
    frame: Frame | None,
) -> list[list[Thing]]:
    if not targets:
        return []
    of_texts = {
        answer.text: things_of_answer(field, question, number, answer)
        for number, answer in enumerate(answers)
    }
    related = any(isinstance(target, Phrase) for target in targets)
    frame = scene_frame(field) if frame is None and related else frame
    return [resolve(field, target, of_texts, frame) for target in targets]


def _related(
    field: CodedScene, relation: str, things: list[Thing], anchors: Sequence[list[Thing]], frame: Frame
) -> list[Thing]:
    if not things or not all(anchors):
        return []
    every = [*things, *(thing for each in anchors for thing in each)]
    shapes = _Shapes.of(field, every, frame)
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


def _ordered(field: CodedScene, phrase: Phrase, things: list[Thing], frame: Frame) -> list[Thing]:
    """The one thing of an order and rank; all without an order."""
    if not phrase.order or not things:
        return things
    if phrase.order in _ENDS:
        axis, sign = _ENDS[phrase.order]
        shapes = _Shapes.of(field, things, frame)
        keys = [sign * float(shapes.middle(number)[axis]) for number in range(len(things))]
    else:
        keys = [(-1 if phrase.order == "largest" else 1) * thing.size for thing in things]
    order = sorted(range(len(things)), key=keys.__getitem__)
    return [things[order[phrase.rank - 1]]] if phrase.rank <= len(things) else []


def related_pairs(field: CodedScene, things: Sequence[Thing], frame: Frame) -> Iterator[tuple[int, str, int]]:
    """Yield which things of a level are inside or on which others: (number, "inside" or "on", number of the other)."""
    shapes = _Shapes.of(field, things, frame)
    low, high = shapes.spans[..., 0], shapes.spans[..., 1]
    heights = (high - low)[:, UP]
    for one, thing in enumerate(things):
        gaps = np.maximum(low[one], low) - np.minimum(high[one], high)
        for other in np.flatnonzero((gaps <= CONTACT * heights[one]).all(1)).tolist():
            if other == one or thing.level != things[other].level:
                continue
            what = next((what for what in ("inside", "on") if CONDITIONS[what](shapes, one, (other,))), "")
            if what:
                yield _number(thing), what, _number(things[other])


def _number(thing: Thing) -> int:
    assert thing.number is not None
    return thing.number
