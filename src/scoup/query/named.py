"""Answers to texts that a model with words was asked in photographs: one rule joins its votes with the field's answer.

Detectors and embeddings fail on different words. Where the photographs do not show a text likely, the field answers
alone. Where the things that the field would answer with have nearly as many votes as any, both agree: these answer,
without those that have few votes. Otherwise the things with most votes answer, lowered where they fit the text badly.
Presence has the odds of the photographs, times a power of the field's. Measured in docs/answers.md.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from scoup.field import Field, NameTable, ThingTable
from scoup.query import constants
from scoup.query.matching import Choice
from scoup.query.question import Question


@dataclass(frozen=True, eq=False)
class Named:
    """A text of a question that has a name in the field."""

    names: NameTable
    number: int
    count: int  # of the things of the field

    @cached_property
    def votes(self) -> Tensor:
        """[T] float32."""
        return self.names.votes_of(self.number, self.count)

    @property
    def is_sure(self) -> bool:
        """Return whether the votes say which things it means."""
        return float(self.names.presence[self.number]) >= constants.LIKELY and bool(self.votes.any())

    def score(self, by_field: float | None = None, thing: int | None = None) -> float:
        """Return the presence of the text, 0 to 1, or of it in one thing, from the field's score of it."""
        presence = float(self.names.presence[self.number])
        if by_field is not None:
            bounded = min(max(by_field, 0.01), 0.99)
            raised = presence * (bounded / (1 - bounded)) ** constants.FIELD_POWER
            presence = raised / (raised + 1 - presence)
        if thing is None or not self.is_sure:
            return presence
        return presence * float(self.votes[thing] / self.votes.max())


def named_texts(table: ThingTable | None, question: Question) -> list[dict[int, Named]]:
    """Return for each text its ``Named`` in a field, by its name or a name near it, as of scene 0; {} without one."""
    if table is None or table.names is None:
        return [{} for _ in question.texts]
    return [{} if named is None else {0: named} for named in find_named(table.names, len(table), question)]


def find_named(names: NameTable, count: int, question: Question) -> list[Named | None]:
    """Return for each text its ``Named`` among ``count`` things, by its name or a name near it; None without one."""
    near = question.near or (None,) * len(question.texts)
    numbers = [
        names.number(other or text) if names.number(text) is None else names.number(text)
        for text, other in zip(question.texts, near, strict=True)
    ]
    return [None if number is None else Named(names, number, count) for number in numbers]


def joined(
    choice: Choice, votes: Tensor, levels: Tensor, usable: Tensor, fits: Tensor, level: int | None = None
) -> Choice:
    """Return the things that answer a text, from a scene's choice and the votes [T] of a model that is sure of it.
    ``levels``, ``usable`` and ``fits`` [T] are of the scene (``ThingIndex``); ``level`` answers, by default the best.
    """
    votes = torch.where(usable & (levels == level) if level is not None else usable, votes, 0.0)
    most, things = votes.max(), torch.tensor(choice.things)
    if most == 0:
        return choice
    chosen = votes[things]
    if chosen.max() >= constants.AGREES * most:
        things = things[chosen >= constants.TOGETHER * chosen.max()]
        return choice.of(things.tolist(), int(levels[things[0]]), fits)
    best = fits[usable].max()
    # A thing that fits like the median thing has e times fewer votes than the best one; in logarithms, as votes
    # underflow where most things fit alike.
    lowered = votes.log() + (fits - best).clamp(max=0) / (best - fits[usable].median()).clamp(min=1e-6)
    together = (lowered >= lowered.max() + math.log(constants.TOGETHER)) & (
        levels == levels[lowered.argmax()]
    )
    things = together.nonzero()[:, 0]
    things = things[lowered[things].argsort(descending=True, stable=True)]
    return choice.of(things.tolist(), int(levels[things[0]]), fits)


def voted_names(field: Field, texts: Collection[str] | None = None) -> dict[int, tuple[str, ...]]:
    """Return the names that a model gave to each thing that it is sure of, best first, all or some of ``texts``."""
    table = field.thing_table
    if table is None or table.names is None or not len(table.names.votes):
        return {}
    names, allowed = table.names, None if texts is None else {text.casefold() for text in texts}
    usable = [row for row, text in enumerate(names.texts) if allowed is None or text.casefold() in allowed]
    votes = names.matrix(len(table))[:, usable]
    if not usable:
        return {}
    sure = (
        (votes > 0)
        & (votes >= constants.TOGETHER * votes.amax(0))
        & (names.presence[usable] >= constants.LIKELY)
    )
    by_thing = {}
    best = less_common(votes).topk(min(constants.NAMES, votes.shape[1]), dim=1).indices
    for thing, row in enumerate(best.tolist()):
        rows = [usable[word] for word in row if sure[thing, word]]
        if rows:
            by_thing[thing] = tuple(names.texts[word] for word in rows)
    return by_thing


def less_common(cosines: Tensor) -> Tensor:
    """Return cosines [T, Q] of things and words, lowered for words that are near to many things."""
    count = min(constants.COMMON_THINGS, len(cosines))
    return cosines - constants.COMMON_SHARE * cosines.topk(count, dim=0).values.sum(0) / max(1, count)
