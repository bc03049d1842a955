"""The names of the things of a scene, and the things that are one object each.

Every thing has a word that fits it best, so this alone names walls "fire extinguisher". A thing and a word have to
choose each other: the scene's answer to the word contains the thing, and hardly any everyday word is nearer to the
thing. So whoever asks for a name finds its thing. A thing of another level with the same Gaussians has this name, too;
everything else is unnamed.

Things of several levels nest: a part in an object in a group. Of each such tree, those things are the objects whose
names fit best, each weighed by its share of what it is a part of. Ours; measured in docs/things.md.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

from scoup.field import Field, ThingTable
from scoup.query import constants
from scoup.query.answer_scene import each_answer
from scoup.query.named import less_common, voted_names
from scoup.query.question import Question
from scoup.query.thing_judge import ThingIndex, shared_gaussians, thing_index
from scoup.query.things import Thing, all_things


class ThingName(NamedTuple):
    """The name of a thing."""

    texts: tuple[str, ...]
    """Up to three, the best first."""
    score: float | None
    """Of the best, for this thing (``Answer.score``)."""


def thing_names(field: Field, question: Question[Any]) -> dict[int, ThingName]:
    """Return the names of the things that have one, by their numbers; those that a model gave come first.

    Args:
        field: with or without things.
        question: of the words that may be names; a word counts as a name only where it is present.
    """
    return field.kept((thing_names, question), lambda: _made_names(field, question))


def _made_names(field: Field, question: Question[Any]) -> dict[int, ThingName]:
    known = thing_index(field, question)
    if known is None:
        return {}
    queries, everyday = question.queries.float().cpu(), question.compared
    near = less_common(known.cosines(queries))
    words = less_common(known.cosines(everyday))
    candidates: dict[int, list[tuple[float, int]]] = {}
    for number, answer in enumerate(each_answer(field, question)):
        for thing in answer.things:
            fit = near[thing, number]
            if int((words[thing] > fit + 1e-6).sum()) <= constants.NEARER_WORDS * len(everyday):
                candidates.setdefault(thing, []).append((-float(fit), number))
    best = {
        thing: [number for _, number in sorted(numbers)[: constants.NAMES]]
        for thing, numbers in candidates.items()
    }
    fits = known.fits(queries)
    scores, names = known.text_scores(question, fits), {}
    for thing, like in _alike(known, best).items():
        texts, first = tuple(question.texts[number] for number in best[like]), best[like][0]
        names[thing] = ThingName(texts, scores[first](float(fits[thing, first])))
    for thing, (texts, voted_score) in voted_names(field, question.texts).items():
        others = names[thing].texts if thing in names else ()
        names[thing] = ThingName(tuple(dict.fromkeys([*texts, *others]))[: constants.NAMES], voted_score)
    return names


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
    """Return all things with their best names as ``text`` and the scores of these, or "" and None.

    Catalogue, page, agents and comparisons name things by this.

    Args:
        field: with or without things.
        words: that may be names (``naming_question``); None: there is no encoder, and only a model's names are known.
    """
    things = all_things(field)
    if words is None:
        return list(things)
    names, unnamed = thing_names(field, words), ThingName(("",), None)
    best = [(thing, names.get(thing.number or 0, unnamed)) for thing in things]
    return [replace(thing, text=name.texts[0], score=name.score) for thing, name in best]


def find_objects(field: Field, things: Sequence[Thing]) -> list[Thing]:
    """Return the named things that are one object each.

    A thing without a parent at the next level is a part of one at a coarser level that has half of its Gaussians.

    Args:
        field: of the things.
        things: all, with their names as ``text`` and the scores of these.
    """
    table = field.thing_table
    if table is None:
        return []
    wholes, steady = field.kept(find_objects, lambda: _nesting(table))

    def is_object(thing: Thing) -> bool:
        return bool(thing.text) or (
            (thing.n_regions or 0) >= constants.LEAST_REGIONS and thing.number in steady
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
    """Return the things of each tree, of things and their parts, whose names fit best together."""
    index_of = {thing.number: number for number, thing in enumerate(things)}
    parts: list[list[int]] = [[] for _ in things]
    roots = []
    for number, thing in enumerate(things):
        (parts[index_of[thing.parent]] if thing.parent in index_of else roots).append(number)

    def best(number: int) -> tuple[float, list[int]]:
        """Return the score of a thing, or of the objects in it if their names fit better, and these."""
        thing = things[number]
        alone = (1.0 if thing.score is None else thing.score) if thing.text else constants.UNNAMED
        below = [best(child) for child in parts[number]]
        sizes = [things[child].n_gaussians / thing.n_gaussians for child in parts[number]]
        together = sum(score * size for (score, _), size in zip(below, sizes, strict=True))
        if together / max(1.0, sum(sizes)) > alone:
            return together / max(1.0, sum(sizes)), [index for _, objects in below for index in objects]
        return alone, [number]

    objects = [index for root in roots for index in best(root)[1]]
    return [things[index] for index in sorted(objects)]
