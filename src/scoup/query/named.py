"""Answers to texts that a model with words was asked in photographs: one rule joins its votes with the field's answer.

Detectors and embeddings fail on different words. Where the photographs do not show a text likely, the field answers
alone. Where the things that the field would answer with have nearly as many votes as any, both agree: these answer,
without those that have few votes. Otherwise the things with most votes answer, lowered where they fit the text badly.
Presence has the odds of the photographs, times a power of the field's. Measured in docs/answers.md.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import torch
from torch import Tensor

from scoup.field import Field
from scoup.query.matching import Choice, ComparedTable, choose_things
from scoup.query.presence import LIKELY
from scoup.query.question import Question
from scoup.scene.names import NameTable
from scoup.scene.things import ThingTable

AGREES = 0.85
"""Both agree if a thing of the field's answer has at least this share of the largest vote."""
TOGETHER = 0.45
"""Things with at least this share of the largest vote answer together."""
FIELD_POWER = 1 / 3
"""Of the field's odds of presence; they are 1 to 99 at least and 99 to 1 at most."""
NAMES = 3
"""Names kept per thing: the best and the next best ones."""
HUB_THINGS, HUB_SHARE = 10, 0.5
"""Some words are near to many things: this share of the mean of a word's so many largest cosines is subtracted from all
of them (cross-domain similarity local scaling, Conneau et al. 2018)."""


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
        return float(self.names.presence[self.number]) >= LIKELY and bool(self.votes.any())

    def score(self, by_field: float | None = None, thing: int | None = None) -> float:
        """Return the presence of the text, 0 to 1, or of it in one thing, from the field's score of it."""
        presence = joined_presence(float(self.names.presence[self.number]), by_field)
        if thing is None or not self.is_sure:
            return presence
        return presence * float(self.votes[thing] / self.votes.max())


def joined_presence(presence: float, by_field: float | None) -> float:
    """Return the presence of a text, from that of the photographs and the field's score of it."""
    if by_field is None:
        return presence
    bounded = min(max(by_field, 0.01), 0.99)
    raised = presence * (bounded / (1 - bounded)) ** FIELD_POWER
    return raised / (raised + 1 - presence)


def named_texts(table: ThingTable | None, question: Question) -> list[Named | None]:
    """Return what things are known of each text by its name, or by a name near to it; None for all other texts."""
    names = None if table is None else table.names
    if table is None or names is None:
        return [None] * len(question.texts)
    near = question.near or (None,) * len(question.texts)
    numbers = [
        names.number(other or text) if names.number(text) is None else names.number(text)
        for text, other in zip(question.texts, near, strict=True)
    ]
    return [None if number is None else Named(names, number, len(table)) for number in numbers]


def choose(
    known: ComparedTable, fits: Tensor, named: Sequence[Named | None], level: int | None = None
) -> list[Choice | None]:
    """Return the things that answer each text of a question, by the field's choice and by names.

    Args:
        known, fits: of the field and the question (``choose_things``).
        named: of the question (``named_texts``).
        level: the one that answers; None: the best.
    """
    return [
        joined(known, choice, fits[:, number], own.votes, level) if choice and own and own.is_sure else choice
        for number, (choice, own) in enumerate(zip(choose_things(known, fits, level), named, strict=True))
    ]


def joined(
    known: ComparedTable, choice: Choice, fits: Tensor, votes: Tensor, level: int | None = None
) -> Choice:
    """Return the things that answer a text, from the field's choice and the votes [T] of a model."""
    levels = known.things.levels.cpu()
    votes = torch.where(known.usable & (levels == level) if level is not None else known.usable, votes, 0.0)
    most = votes.max()
    if most == 0:
        return choice
    mine = votes[choice.things]
    if mine.max() >= AGREES * most:
        return _chosen(choice, choice.things[mine >= TOGETHER * mine.max()], fits)
    usable = fits[known.usable]
    best = usable.max()
    # A thing that fits like the median thing has e times fewer votes than one that fits best; as logarithms, because
    # where most things fit alike, others have fewer than any number is small.
    lowered = votes.log() + (fits - best).clamp(max=0) / (best - usable.median()).clamp(min=1e-6)
    together = (lowered >= lowered.max() + math.log(TOGETHER)) & (levels == levels[lowered.argmax()])
    things = together.nonzero()[:, 0]
    return _chosen(choice, things[lowered[things].argsort(descending=True, stable=True)], fits)


def _chosen(choice: Choice, things: Tensor, fits: Tensor) -> Choice:
    rival = choice.runner_up if choice.runner_up is None or choice.runner_up not in things.tolist() else None
    lost = [thing for thing in choice.things.tolist() if thing not in things.tolist()]
    return replace(choice, things=things, fit=float(fits[things].max()), runner_up=lost[0] if lost else rival)


def voted_names(
    field: Field, texts: Collection[str] | None = None
) -> dict[int, tuple[tuple[str, ...], float]]:
    """Return the names that a model gave to each thing that it is sure of, best first, and the score of the first.

    Args:
        field: with or without names.
        texts: that may be names; None: all.
    """
    table = field.thing_table
    if table is None or table.names is None or not len(table.names.votes):
        return {}
    names, allowed = table.names, None if texts is None else {text.casefold() for text in texts}
    usable = [row for row, text in enumerate(names.texts) if allowed is None or text.casefold() in allowed]
    votes = names.matrix(len(table))[:, usable]
    if not usable:
        return {}
    sure = (votes > 0) & (votes >= TOGETHER * votes.amax(0)) & (names.presence[usable] >= LIKELY)
    found = {}
    for thing, row in enumerate(best_words(votes).tolist()):
        mine = [usable[word] for word in row if sure[thing, word]]
        if mine:
            score = Named(names, mine[0], len(table)).score(thing=thing)
            found[thing] = tuple(names.texts[word] for word in mine), score
    return found


def best_words(cosines: Tensor) -> Tensor:
    """Return the up to ``NAMES`` words that name each thing best, [T, n] int64, from cosines [T, Q] of both."""
    return less_common(cosines).topk(min(NAMES, cosines.shape[1]), dim=1).indices


def less_common(cosines: Tensor) -> Tensor:
    """Return cosines [T, Q] of things and words, lowered for words that are near to many things."""
    count = min(HUB_THINGS, len(cosines))
    return cosines - HUB_SHARE * cosines.topk(count, dim=0).values.sum(0) / max(1, count)
