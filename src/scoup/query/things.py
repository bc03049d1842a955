"""The things of a scene as objects: every instance with position, box and Gaussians, or the things of a text."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from scoup.base import WorldFrame, rounded_vector
from scoup.field import Field, ThingTable
from scoup.query import constants
from scoup.query.answer import Answer, ExpressionAnswer, answer_relevancy
from scoup.query.boxes import OrientedBox, PointSets
from scoup.query.named import named_texts, voted_names
from scoup.query.presence import LEAST_GAUSSIANS
from scoup.query.question import Question
from scoup.query.thing_judge import ThingIndex, thing_index
from scoup.query.votes import true_rows
from scoup.raster import morton_codes
from scoup.scene import linked_parts, nearest_points

NEIGHBOURS = 8
"""Each point is linked to so many of its nearest others."""
LONGEST_LINK = 3.0
"""Links longer than this times the median are cut, so that strays fall off."""

MOST_LINKED = 8192
"""Of more points than these, the cells of a grid are linked instead."""


@dataclass(frozen=True, eq=False, repr=False)
class Thing:
    """One instance in a scene.

    Example:
        >>> thing = field.things(field.question("kettle", always=True))[0]
        >>> thing.position.shape, thing.box.extent.shape, thing.n_gaussians == len(thing.gaussians)
        (torch.Size([3]), torch.Size([3]), True)
    """

    number: int | None
    """Its row in ``field.thing_table``, the same for every question; None for a part of a selection."""
    level: str
    """Name of its level."""
    parent: int | None
    """Number of the thing of the next coarser level that contains most of it."""
    text: str
    """The text it answers, or its name; "" if nothing was asked and no model named it."""
    score: float | None
    """As of ``Answer``, for this thing alone. None of a name, with too few everyday words, and for a part of a
    selection."""
    position: Tensor
    """[3] float64 world units: the weighted median of its Gaussians."""
    box: OrientedBox
    """Around it."""
    gaussians: Tensor
    """[M] int64, the Gaussians of it."""
    n_regions: int | None
    """How many regions of photographs it was merged from, about one per view; None for a part of a selection."""
    world: WorldFrame = field(default_factory=WorldFrame)
    """That of its field."""
    named_by: Literal["detector", "embedding", ""] = ""
    """Where ``text`` comes from if it is a name; "" if it is what was asked, or empty."""
    word_score: float | None = None
    """Score of its nearest word, if the answer to it contains the thing, also if that word is no name: objects have
    larger ones than parts and groups."""

    @classmethod
    def of_table(cls, field: Field, numbers: Sequence[int]) -> list[Thing]:
        """Return the instances of a field with some numbers, but for those without a usable Gaussian."""
        table = field.thing_table
        assert table is not None
        members: list[Tensor] = [torch.empty(0, dtype=torch.int64)] * len(numbers)
        index_of = torch.full((len(table) + 1,), -1, dtype=torch.int64)
        index_of[torch.tensor(numbers, dtype=torch.int64)] = torch.arange(len(numbers))
        for owners in table.owners.cpu().T:
            indices = index_of[owners.long()]  # NO_THING reads the last, -1
            rows = true_rows(indices >= 0)
            order = indices[rows].argsort(stable=True)
            of_thing, counts = indices[rows].unique(return_counts=True)
            for number, gaussians in zip(of_thing.tolist(), rows[order].split(counts.tolist()), strict=True):
                members[number] = gaussians
        parents, n_regions = table.parents.tolist(), table.n_regions.tolist()
        return [
            replace(
                thing,
                number=number,
                level=field.levels[int(table.levels[number])],
                parent=None if parents[number] < 0 else parents[number],
                n_regions=n_regions[number],
            )
            for number, thing in zip(numbers, _parts(field, members, ""), strict=True)
            if thing is not None
        ]

    @property
    def n_gaussians(self) -> int:
        """Return the number of Gaussians."""
        return len(self.gaussians)

    @property
    def size(self) -> float:
        """Diagonal of its box in world units."""
        return float(self.box.extent.norm())

    @property
    def title(self) -> str:
        """Its text, or its number: "thing 231"."""
        return self.text or ("part" if self.number is None else f"thing {self.number}")

    def __repr__(self) -> str:
        what = f"thing {self.number}" if self.number is not None else "part"
        named = f" {self.text!r}" if self.text else ""
        position = rounded_vector(self.position.tolist())
        return f"Thing({what}{named} at {position}, level {self.level}, {self.n_gaussians:,} Gaussians)"

    def describe(self) -> str:
        """Return position and extent in words, for people."""
        return self.world.place(self.position.tolist(), self.box.extent.tolist())

    def to_dict(self) -> dict[str, Any]:
        """Return the thing as plain JSON values, rounded; in metres, too, if its field knows the length of its unit."""
        return {
            "thing": self.number,
            "text": self.text,
            **({"named_by": self.named_by} if self.named_by else {}),
            "level": self.level,
            "parent": self.parent,
            "score": None if self.score is None else round(self.score, 4),
            "position": rounded_vector(self.position.tolist()),
            "box": self.box.to_dict(),
            **self.world.metres(self.position.tolist(), self.box.extent.tolist()),
            "gaussians": self.n_gaussians,
            "regions": self.n_regions,
        }


@dataclass(frozen=True, eq=False, repr=False)
class Place:
    """The place of an answer in the world. Tensors are on the CPU.

    Example:
        >>> field = scoup.LanguageField.load("f.scoup")
        >>> place = field.location(field.question("kettle", always=True))
        >>> place.position.shape
        torch.Size([3])
    """

    answer: Answer
    """All that answers, with level, score and presence."""
    thing: Thing | None
    """The first of ``field.things``; None if it is not there."""

    @property
    def position(self) -> Tensor | None:
        """[3] float64 world units, the median of the thing's Gaussians; None if it is not there."""
        return None if self.thing is None else self.thing.position

    @property
    def box(self) -> OrientedBox | None:
        """Around the thing; None if it is not there."""
        return None if self.thing is None else self.thing.box

    @property
    def presence(self) -> bool:
        """True if the thing is there, or if that was not judged and any Gaussian answers."""
        return self.thing is not None

    def __repr__(self) -> str:
        return f"Place({self.answer.text!r}: {self.describe()})"

    def describe(self) -> str:
        """Return how many things it is, the place of the first, and the score, in a few words."""
        if self.thing is None:
            return self.answer.remark()
        first = ", the first" if len(self.answer.things) > 1 else ""
        return f"{self.answer.counted()}{first} at {self.thing.describe()}, {self.answer.remark()}".lstrip()

    def to_dict(self) -> dict[str, Any]:
        """Return the place as plain JSON values, rounded; in metres, too, as of ``Thing``."""
        kept = "position_metres", "extent_metres", "position", "box"
        thing = {} if self.thing is None else self.thing.to_dict()
        place = {name: thing[name] for name in kept if name in thing} or {"position": None, "box": None}
        return {**place, **self.answer.to_dict()}


def all_things(field: Field) -> list[Thing]:
    """Return every instance of a field with at least ``LEAST_GAUSSIANS`` Gaussians, finer levels first, from its cache.

    Empty for a field without things.
    """
    table = field.thing_table
    if table is None:
        return []

    def made() -> list[Thing]:
        counts, voted = table.sums(torch.ones(len(table.owners))), voted_names(field)
        return [
            replace(thing, text=voted[number][0], named_by="detector")
            if (number := thing.number) in voted
            else thing
            for thing in Thing.of_table(field, (counts >= LEAST_GAUSSIANS).nonzero()[:, 0].tolist())
        ]

    return field.kept(Thing, made)


def things_of_answer(field: Field, answer: Answer) -> list[Thing]:
    """Return the things of an answer, best first; none where the text is not present.

    Where the votes answer, they are the parts of the selection that are connected in space, those that weigh most
    first.
    """
    if not answer.presence or not bool(answer.mask.any()):
        return []
    if isinstance(answer, ExpressionAnswer) and (answer.found or answer.threshold is None):
        return list(answer.found)
    if not answer.things:
        return _connected_things(field, answer)
    scores = dict(zip(answer.things, answer.scores, strict=True))
    return [
        replace(thing, text=answer.word, score=scores[thing.number or 0])
        for thing in Thing.of_table(field, answer.things)
    ]


def place_of(field: Field, answer: Answer) -> Place:
    """Return the place of an answer."""
    return Place(answer, next(iter(things_of_answer(field, answer)), None))


def best_part(field: Field, question: Question[Any], text: str, thing: Thing) -> Thing:
    """Return the part of a thing that fits a text of a question best, or the thing itself."""
    one = question.one(question.texts.index(text))
    known, table = thing_index(field, one), field.thing_table
    assert known is not None
    assert table is not None
    assert thing.number is not None
    every = known.fits(one.queries)
    fits = every[:, 0].tolist()
    best = best_part_number(table, known, fits, thing.number)
    if best == thing.number:
        return thing
    (score,) = known.text_scores(one, every, named_texts(table, one))
    best_parts = [
        replace(part, text=thing.text, score=score(fits[best], best))
        for part in Thing.of_table(field, [best])
    ]
    return best_parts[0] if best_parts else thing


def best_part_number(table: ThingTable, known: ThingIndex, fits: Sequence[float], thing: int) -> int:
    """Return the number of the part of a thing with the largest of the fits [T] to a text, or its own."""
    inside = table.parts(thing) & known.usable & (known.counts >= LEAST_GAUSSIANS)
    return max(inside.nonzero()[:, 0].tolist(), key=fits.__getitem__, default=thing)


def _parts(field: Field, members: Sequence[Tensor], level: str) -> list[Thing | None]:
    """Return the parts of a selection from the Gaussians of each; None for those without a usable Gaussian."""
    points = PointSets.of(field.gaussians, members)
    shapes = zip(points.medians(), points.boxes(field.up()), members, strict=True)
    return [
        box
        and Thing(
            None, level, None, "", None, torch.from_numpy(position.copy()), box, rows, None, field.world
        )
        for position, box, rows in shapes
    ]


def _connected_things(field: Field, answer: Answer) -> list[Thing]:
    """Return the connected parts of a selection, heaviest first; a Gaussian weighs opacity times relevancy."""
    rows = true_rows(answer.mask)
    gaussians = field.gaussians.select(rows.to(field.gaussians.device)).to("cpu")
    usable = torch.isfinite(gaussians.means).all(1) & torch.isfinite(gaussians.opacities)
    rows, means = rows[usable], gaussians.means[usable].double().numpy()
    if not len(rows):
        return []
    relevancy = answer_relevancy(field, answer)[rows].double()
    parts = rough_parts(means)
    weights = np.bincount(parts, (gaussians.opacities[usable].double().clamp(0, 1) * relevancy).numpy())
    sizes = np.bincount(parts)
    heaviest = np.argsort(-weights, kind="stable").tolist()
    largest = [
        part
        for part in heaviest
        if sizes[part] >= LEAST_GAUSSIANS and weights[part] >= constants.STRAY_SHARE * weights.max()
    ] or heaviest[:1]  # the heaviest if all are small
    members = [rows[torch.from_numpy(parts == part)] for part in largest]
    return [
        replace(thing, text=answer.word)
        for thing in _parts(field, members, answer.level)
        if thing is not None
    ]


def rough_parts(points: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return ``connected_parts`` of points [M, 3], or where they are many, of the cells of a grid that they fill."""
    if len(points) <= MOST_LINKED:
        return connected_parts(points)
    places, order = morton_codes(torch.from_numpy(points))[0].sort()
    differing = places[1:] ^ places[:-1]
    coarser = bisect_left(
        range(21), True, key=lambda step: int((differing >> 3 * step > 0).sum()) < MOST_LINKED
    )
    cells = torch.empty_like(order)
    cells[order] = torch.nn.functional.pad(differing >> 3 * coarser > 0, (1, 0)).cumsum(0)
    cell_of = cells.numpy()
    middles = np.stack([np.bincount(cell_of, axis) for axis in points.T], 1) / np.bincount(cell_of)[:, None]
    return connected_parts(middles)[cell_of]


def connected_parts(points: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the number [M] of the connected part of each point [M, 3].

    Each point is linked to its nearest others, and links much longer than usual are cut.
    """
    count = min(NEIGHBOURS, len(points) - 1)
    if count < 1:
        return np.zeros(len(points), np.int64)
    nearest, lengths = nearest_points(points, count)
    return linked_parts(nearest, lengths, LONGEST_LINK * float(np.median(lengths[:, -1])))
