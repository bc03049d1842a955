"""The names of the things of a scene, and the things that are one object each.

Every thing has a word that fits it best, so this alone names walls "fire extinguisher". A thing and a word have to
choose each other: the thing's nearest word is a name only if the scene's answer to it contains the thing. Of many words
the nearest is wrong in most cases, but what several of the nearest have in common is often right: a broader word, such
as "footwear" for a sandal. A thing of another level with the same Gaussians has this name, too; everything else is
unnamed. How well a word fits says nothing about whether it is right, so names have no score.

Things of several levels nest: a part in an object in a group. Of each such tree, those things are the objects whose
nearest words fit best, named or not, each weighed by its share of what it is a part of. Ours; measured in
docs/things.md.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from scoup.field import Field, ThingTable
from scoup.query import constants
from scoup.query.named import less_common, named_texts, voted_names
from scoup.query.question import Question
from scoup.query.thing_judge import ThingIndex, shared_gaussians, thing_index
from scoup.query.things import Thing, all_things


class ThingName(NamedTuple):
    """The name of a thing."""

    texts: tuple[str, ...]
    """Up to three, the best first; none if only its nearest word is known."""
    word_score: float | None
    """As of ``Thing``."""


@cache
def broader_words() -> dict[str, frozenset[str]]:
    """Return broader words, each with the words below it (broader_words.txt)."""
    text = Path(__file__).with_name("broader_words.txt").read_text(encoding="utf-8")
    pairs = (line.split(": ") for line in text.splitlines() if not line.startswith("#"))
    return {broader: frozenset(words.split(", ")) for broader, words in pairs}


def thing_names(field: Field, question: Question[Any]) -> dict[int, ThingName]:
    """Return the names of the things that have one, or whose nearest word's answer contains them, by their numbers;
    those that a detector gave come first. A word of the question counts as a name only where it is present."""
    return field.kept((thing_names, question), lambda: _made_names(field, question))


def _made_names(field: Field, question: Question[Any]) -> dict[int, ThingName]:
    known = thing_index(field, question)
    if known is None:
        return {}
    texts = question.texts
    near = less_common(known.cosines(question.queries))
    nearest = near.topk(min(constants.NEAREST_WORDS, len(texts)), dim=1).indices.tolist()
    named: dict[int, ThingName] = {}
    for number, (verdict,) in enumerate(known.judge(question, named_texts(field.thing_table, question))):
        for thing, score in zip(verdict.things, verdict.scores, strict=True) if verdict.presence else ():
            if nearest[thing][0] == number:
                words = [texts[word] for word in nearest[thing]]
                named[thing] = ThingName(
                    _broader(words) if len(texts) > constants.SHORT_LIST else (texts[number],), score
                )
    names = {thing: named[like] for thing, like in _alike(known, named).items()}
    for thing, voted in voted_names(field, texts).items():
        others, score = names.get(thing, ThingName((), None))
        names[thing] = ThingName(tuple(dict.fromkeys([*voted, *others]))[: constants.NAMES], score)
    return names


def _broader(nearest: Sequence[str]) -> tuple[str, ...]:
    """Return the narrowest broader word of most of the nearest words of a thing, and the nearest of these; () without
    one."""
    below = [(len(words), broader) for broader, words in broader_words().items()
             if len(words.intersection(nearest)) >= constants.IN_COMMON]  # fmt: skip
    if not below:
        return ()
    broader = min(below)[1]
    own = [word for word in nearest if word in broader_words()[broader]]
    return tuple(dict.fromkeys([broader, *own]))[: constants.NAMES]


def _alike(known: ThingIndex, named: Collection[int]) -> dict[int, int]:
    """Return the named things and things of other levels with the same Gaussians, each with its named one."""
    counts = known.counts.tolist()
    best: dict[int, tuple[float, int]] = {}
    for one, other, both in known.shares.pairs():
        share = both / max(1.0, counts[one] + counts[other] - both)
        if one in named and (one == other or (other not in named and share >= constants.SAME_GAUSSIANS)):
            best[other] = max(best.get(other, (0.0, one)), (share, one))
    return {thing: one for thing, (_, one) in best.items()}


def named_things(field: Field, words: Question[Any] | None) -> list[Thing]:
    """Return all things with their best names as ``text``, or "": some of ``words`` (``naming_question``), or without
    an encoder, and so words, only a detector's.

    Catalogue, page, agents and comparisons name things by this.
    """
    things = all_things(field)
    if words is None:
        return list(things)
    names, unnamed, voted = thing_names(field, words), ThingName((), None), voted_names(field, words.texts)
    named = []
    for thing in things:
        texts, score = names.get(thing.number or 0, unnamed)
        by = "detector" if thing.number in voted else "embedding" if texts else ""
        named.append(replace(thing, text=texts[0] if texts else "", named_by=by, word_score=score))
    return named


def find_objects(field: Field, things: Sequence[Thing]) -> list[Thing]:
    """Return the named things that are one object each, among all with their names as ``text``.

    A thing without a parent at the next level is a part of one at a coarser level that has half of its Gaussians.
    """
    table = field.thing_table
    if table is None:
        return []
    wholes, steady = field.kept(find_objects, lambda: _nesting(table))

    def is_object(thing: Thing) -> bool:
        return (
            bool(thing.text)
            or thing.word_score is not None
            or ((thing.n_regions or 0) >= constants.LEAST_REGIONS and thing.number in steady)
        )

    nested = [
        replace(thing, parent=wholes.get(thing.number)) if thing.parent is None else thing for thing in things
    ]
    objects = {thing.number for thing in best_of_trees(nested)}
    return [thing for thing in things if thing.number in objects and is_object(thing)]


def _nesting(table: ThingTable) -> tuple[dict[int | None, int], set[int | None]]:
    """Return the thing of the next coarser level that has half of the Gaussians of each thing, and the things that are
    stable, or that another level found, too."""
    pairs, levels = shared_gaussians(table).pairs(), table.levels.tolist()
    counts = {one: both for one, other, both in pairs if one == other}
    wholes: dict[int | None, int] = {}
    steady: set[int | None] = {*(table.stability >= constants.STABLE).nonzero()[:, 0].tolist()}
    for one, other, both in sorted(pairs, key=lambda pair: (-levels[pair[1]], pair[2])):
        if levels[one] < levels[other]:
            if both >= constants.SAME_GAUSSIANS * counts[one]:
                wholes[one] = other  # the last is of the finest level
            if both >= constants.SAME_GAUSSIANS * (counts[one] + counts[other] - both):
                steady |= {one, other}
    return wholes, steady


def best_of_trees(things: Sequence[Thing]) -> list[Thing]:
    """Return the things of each tree, of things and their parts, whose nearest words fit best together."""
    index_of = {thing.number: number for number, thing in enumerate(things)}
    parts: list[list[int]] = [[] for _ in things]
    roots = []
    for number, thing in enumerate(things):
        (parts[index_of[thing.parent]] if thing.parent in index_of else roots).append(number)

    def best(number: int) -> tuple[float, list[int]]:
        """Return the score of a thing, or of the objects in it if their words fit better, and these."""
        thing = things[number]
        certain = 1.0 if thing.text else constants.UNNAMED
        alone = certain if thing.word_score is None else thing.word_score
        below = [best(child) for child in parts[number]]
        sizes = [things[child].n_gaussians / thing.n_gaussians for child in parts[number]]
        together = sum(score * size for (score, _), size in zip(below, sizes, strict=True))
        if together / max(1.0, sum(sizes)) > alone:
            return together / max(1.0, sum(sizes)), [index for _, objects in below for index in objects]
        return alone, [number]

    objects = [index for root in roots for index in best(root)[1]]
    return [things[index] for index in sorted(objects)]
