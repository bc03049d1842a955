"""Relations between things, and the things that a phrase singles out by its relations and its order.

Conditions are measured along the directions of a frame: spans along right, up and away (``PointSets.spans``) stand for
things; contact for "on" is measured from the Gaussians below. The rules are ours; `python -m benchmarks things`
measures them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scoup.field import Field
from scoup.query import constants
from scoup.query.boxes import PointSets
from scoup.query.frame import Frame, scene_frame
from scoup.query.phrases import Phrase, Target, texts_of
from scoup.query.things import Thing, all_things

RIGHT, UP, AWAY = range(3)
_ENDS = {
    "left": (RIGHT, 1),
    "right": (RIGHT, -1),
    "top": (UP, -1),
    "bottom": (UP, 1),
    "front": (AWAY, 1),
    "back": (AWAY, -1),
}
"""Side that an order counts from -> axis, and the sign with which it counts."""


Array = NDArray[np.float64]
Condition = Callable[["Shapes", int, tuple[int, ...]], bool]


@dataclass(frozen=True, eq=False)
class Shapes:
    """Things along the axes of a frame: right, up, away."""

    things: Sequence[Thing]
    points: PointSets  # in the frame's axes
    spans: Array  # [T, 3, 2]

    @classmethod
    def of(cls, field: Field, things: Sequence[Thing], frame: Frame) -> Shapes:
        points = PointSets.of(field.gaussians, [thing.gaussians for thing in things])
        points = replace(points, means=points.means @ frame.axes.numpy().T)
        return cls(things, points, points.spans())

    def middle(self, number: int) -> Array:
        return self.spans[number].mean(1)

    def extent(self, number: int) -> Array:
        return self.spans[number, :, 1] - self.spans[number, :, 0]

    def gap(self, one: int, other: int) -> float:
        """Return the distance between the spans of two things; 0 where they overlap."""
        low = np.maximum(self.spans[one, :, 0], self.spans[other, :, 0])
        high = np.minimum(self.spans[one, :, 1], self.spans[other, :, 1])
        return float(np.linalg.norm((low - high).clip(min=0)))

    def overlap(self, one: int, other: int) -> float:
        """Return the share of one thing's footprint that lies over another's."""
        share = 1.0
        for axis in (RIGHT, AWAY):
            low = max(self.spans[one, axis, 0], self.spans[other, axis, 0])
            high = min(self.spans[one, axis, 1], self.spans[other, axis, 1])
            share *= max(0.0, high - low) / (self.spans[one, axis, 1] - self.spans[one, axis, 0] or 1.0)
        return share

    def top_below(self, one: int, other: int) -> float:
        """Return the height that another thing reaches around the footprint of one, not above its middle; minus
        infinity if none."""
        heights = self._around(one, other, 0.5)[:, UP]
        heights = heights[heights <= self.middle(one)[UP]]
        return float(np.quantile(heights, 0.9)) if len(heights) else -np.inf

    def surrounds(self, one: int, other: int) -> bool:
        """Return whether a thing has Gaussians on nearly all sides of another, at the heights of the other."""
        means = self.points.of_one(one)
        low, high = self.spans[other, UP]
        beside = self._sectors(means[(means[:, UP] >= low) & (means[:, UP] <= high)], other)
        return bool((beside > 0).mean() >= constants.SURROUNDED)

    def encloses(self, one: int, other: int) -> bool:
        """Return whether a thing that another lies on rises around or above it, as a bowl or a shelf does."""
        low, high = self.spans[other, UP]
        over, near = self._around(other, one, 0.0)[:, UP], self._around(other, one, 1.0)
        if len(over) and (over > high).mean() >= constants.ENCLOSED[1]:
            return True
        every = self._sectors(near, other)
        beside = self._sectors(near[near[:, UP] >= low + constants.CONTACT * (high - low)], other)
        return bool((beside > constants.ENCLOSED[0] * every).mean() >= constants.SURROUNDED)

    def _around(self, one: int, other: int, margin: float) -> Array:
        """Return the means of another over and around the footprint of one, as far as a multiple of its extent."""
        means = self.points.of_one(other)
        margins = margin * self.extent(one)
        around = np.ones(len(means), bool)
        for axis in (RIGHT, AWAY):
            low, high = self.spans[one, axis, 0] - margins[axis], self.spans[one, axis, 1] + margins[axis]
            around &= (means[:, axis] >= low) & (means[:, axis] <= high)
        return means[around]

    def _sectors(self, means: Array, other: int) -> NDArray[np.int64]:
        """Return the number of means in each direction from another thing."""
        away = means - self.middle(other)
        sectors = np.floor(
            (np.arctan2(away[:, AWAY], away[:, RIGHT]) / np.pi + 1) / 2 * constants.DIRECTIONS
        ).astype(int)
        return np.bincount(sectors.clip(0, constants.DIRECTIONS - 1), minlength=constants.DIRECTIONS)


def _beyond(axis: int, sign: int) -> Condition:
    """Return the condition that the middle of one lies clearly on one side of another along an axis."""

    def holds(shapes: Shapes, one: int, others: tuple[int, ...]) -> bool:
        offset = sign * (shapes.middle(one)[axis] - shapes.middle(others[0])[axis])
        return bool(offset > constants.CLEAR * 0.5 * shapes.extent(others[0])[axis])

    return holds


def _touches(shapes: Shapes, one: int, other: int) -> bool:
    """Return whether the bottom of one is where another ends around its footprint."""
    if shapes.overlap(one, other) < constants.OVER:
        return False
    gap = shapes.spans[one, UP, 0] - shapes.top_below(one, other)
    return bool(abs(gap) <= constants.CONTACT * shapes.extent(one)[UP])


def _on(shapes: Shapes, one: int, others: tuple[int, ...]) -> bool:
    if not _touches(shapes, one, others[0]):
        return False
    # Of two that seem to be on each other, the one with the higher bottom is.
    lower = shapes.spans[one, UP, 0] < shapes.spans[others[0], UP, 0]
    return not (lower and _touches(shapes, others[0], one))


def _above(shapes: Shapes, one: int, others: tuple[int, ...]) -> bool:
    other = others[0]
    over = max(shapes.overlap(one, other), shapes.overlap(other, one))
    height = shapes.extent(one)[UP]
    clear = shapes.spans[one, UP, 0] >= shapes.spans[other, UP, 1] - constants.CONTACT * height
    # A thing on the lower end of something tall is not under it.
    clear = clear and not _on(shapes, other, (one,))
    return bool(over >= constants.OVER_PART and (clear or _on(shapes, one, others)))


def _under(shapes: Shapes, one: int, others: tuple[int, ...]) -> bool:
    return _above(shapes, others[0], (one,))


def _inside(shapes: Shapes, one: int, others: tuple[int, ...]) -> bool:
    other = others[0]
    if (
        shapes.overlap(one, other) < constants.OVER
        or shapes.extent(one).prod() >= shapes.extent(other).prod()
    ):
        return False
    low, high = shapes.spans[one, UP]
    within = min(high, shapes.spans[other, UP, 1]) - max(low, shapes.spans[other, UP, 0])
    return bool(within > constants.CONTACT * (high - low) and shapes.surrounds(other, one))


def _near(shapes: Shapes, one: int, others: tuple[int, ...]) -> bool:
    larger = max(np.linalg.norm(shapes.extent(one)), np.linalg.norm(shapes.extent(others[0])))
    return bool(shapes.gap(one, others[0]) <= constants.NEAR * larger)


def _between(shapes: Shapes, one: int, others: tuple[int, ...]) -> bool:
    start, end = shapes.middle(others[0]), shapes.middle(others[1])
    line, offset = end - start, shapes.middle(one) - start
    length = float(np.linalg.norm(line))
    if length <= 0:
        return False
    along = float(offset @ line) / length**2
    low, high, aside = constants.BETWEEN
    return bool(low <= along <= high and np.linalg.norm(offset - along * line) <= aside * length)


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


def touching_things(shapes: Shapes) -> Iterator[tuple[int, int, bool, bool]]:
    """Yield two things that are near enough, and whether the first is inside and on the second; no others are."""
    low, high = shapes.spans[..., 0], shapes.spans[..., 1]
    heights, starts = shapes.points.means[:, UP], shapes.points.starts[:-1]
    # Beyond its span, a thing may reach around the footprint of another.
    bottoms, tops = np.minimum.reduceat(heights, starts), np.maximum.reduceat(heights, starts)
    reach = constants.CONTACT * (high - low)[:, UP]
    for one in range(len(low)):
        near = (np.minimum(high[one], high) >= np.maximum(low[one], low))[:, [RIGHT, AWAY]].all(1)
        near &= (bottoms <= high[one, UP] + reach[one]) & (tops >= low[one, UP] - reach[one])
        for other in np.flatnonzero(near).tolist():
            if other != one:
                yield one, other, _inside(shapes, one, (other,)), _on(shapes, one, (other,))


def resolve(
    field: Field, target: Target, of_texts: Mapping[str, Sequence[Thing]], frame: Frame | None
) -> list[Thing]:
    """Return the things that a text or phrase singles out, in the order of the phrase or of ``of_texts``, the things
    that answer each text (of "", all objects); a text alone needs no frame."""
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
