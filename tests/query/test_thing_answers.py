"""Things that answer texts: the choice against a plain reading of the rule, and answers in a planted scene."""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from planted_wall import COUNT, LEVELS, SETTINGS, Wall, planted_wall
from query.conftest import random_vectors, without_things
from scoup.field import NO_THING, ThingTable
from scoup.query import constants, matching
from scoup.query.ask import each_answer
from scoup.query.language_field import LanguageField, build
from scoup.query.matching import choose_things
from scoup.query.thing_judge import ThingIndex, thing_index
from support import altered, examples, things_of

# The choice.


def planted_table(owners: Tensor, levels: Tensor, mass: Tensor | None = None) -> ThingTable:
    """Things [T] of Gaussians [N, S], seen equally well."""
    mass = torch.ones(len(levels)) if mass is None else mass.float()
    return things_of(owners, levels, random_vectors(len(levels), 8), mass=mass)


def compared(things: ThingTable) -> ThingIndex:
    return ThingIndex.of(things, random_vectors(4, 8, seed=1))


Scored = tuple[float, list[int], int | None]
"""A score, a set of things and the rival."""


def is_elsewhere(own: set[int], whole: set[int]) -> bool:
    shares = len(own & whole) / len(own), len(own & whole) / len(whole)
    return shares[0] < constants.SAME_GAUSSIANS and shares[1] <= constants.SAME_GAUSSIANS


def literal_sets(things: ThingTable, fits: Sequence[float], level: int | None) -> list[Scored]:
    """The score of every set that may answer, with the things in it and the thing elsewhere that fits best."""
    owners = things.owners.tolist()
    gaussians = [{row for row, own in enumerate(owners) if thing in own} for thing in range(len(things))]
    known = things.embeddings.any(1) & (things.mass > 0)
    usable = [thing for thing in range(len(things)) if gaussians[thing] and known[thing]]
    in_order = sorted(fits[thing] for thing in usable)
    top, middle = (in_order[-1], in_order[(len(in_order) - 1) // 2]) if usable else (0.0, 0.0)
    alone: list[list[Scored]] = []
    for each in range(things.owners.shape[1]):
        mine = [thing for thing in usable if int(things.levels[thing]) == each]
        mine.sort(key=lambda thing: -fits[thing])
        alone.append([])
        for size in range(1, min(constants.MOST_TOGETHER, len(mine)) + 1):
            chosen, last = mine[:size], fits[mine[size - 1]]
            behind = fits[mine[size]] if size < len(mine) else min(middle, fits[mine[-1]])
            weights = [float(things.mass[thing]) for thing in chosen]
            mean = float(np.average([fits[thing] for thing in chosen], weights=weights))
            whole = set().union(*(gaussians[thing] for thing in chosen))
            rivals = [thing for thing in usable if is_elsewhere(gaussians[thing], whole)]
            rival = max(rivals, key=lambda thing: fits[thing], default=None)
            lead = 0.0 if rival is None else max(0.0, fits[rival] - mean)
            score = min(last - behind, constants.MOST_GAP) - (top - mean) - constants.RIVAL * lead
            alone[-1].append((score, chosen, rival))
    found, large = [], []
    for each, sets in enumerate(alone):
        mine = [thing for thing in usable if int(things.levels[thing]) == each]
        owned = len(set().union(*(gaussians[thing] for thing in mine)))
        for score, chosen, rival in sets if level in (None, each) else ():
            whole, added = set().union(*(gaussians[thing] for thing in chosen)), 0.0
            for others in (*alone[:each], *alone[each + 1 :]):
                best = 0.0
                for their_score, theirs, _ in others:
                    them = set().union(*(gaussians[thing] for thing in theirs))
                    if len(whole & them) > constants.SAME_GAUSSIANS * len(whole | them):
                        best = max(best, their_score + constants.MOST_GAP)
                added += best
            is_large = len(whole) > constants.MOST_COVERED * owned and fits[chosen[0]] != top
            (large if is_large else found).append((score + constants.AGREEMENT * added, chosen, rival))
    return found or large


def check_choice(things: ThingTable, fits: Tensor, level: int | None) -> None:
    for query, (found,) in enumerate(choose_things(compared(things), fits, level)):
        expected = literal_sets(things, fits[:, query].tolist(), level)
        assert (found is None) == (not expected)
        if found is None:
            continue
        best = max(score for score, _, _ in expected)
        chosen = [*found.things]
        near = {tuple(each): rival for score, each, rival in expected if score > best - 1e-4}
        assert tuple(chosen) in near
        rival = near[tuple(chosen)]
        assert (found.runner_up is None) == (rival is None)
        if found.runner_up is not None:  # of rivals alike, either
            assert fits[found.runner_up, query] == fits[rival, query]
        assert found.fit == float(fits[chosen[0], query])


@st.composite
def tables(draw: st.DrawFn) -> tuple[ThingTable, Tensor, int | None]:
    """Things of up to three levels, some of them alike, without Gaussians, embedding or mass; and their fits."""
    counts = draw(st.lists(st.integers(0, 11), min_size=1, max_size=3))
    n_gaussians, seed = draw(st.sampled_from([1, 6, 40])), draw(st.integers(0, 2**31))
    generator = torch.Generator().manual_seed(seed)
    levels = torch.arange(len(counts)).repeat_interleave(torch.tensor(counts))
    # Things of all levels follow one order of the Gaussians, so that many of them are nested or the same.
    place = (torch.arange(n_gaussians) + draw(st.integers(0, 3))) / (n_gaussians + 3)
    owners = torch.full((n_gaussians, len(counts)), NO_THING)
    for level, count in enumerate(counts):
        if count:
            owners[:, level] = (place * count).long() + sum(counts[:level])
    owners[torch.rand(owners.shape, generator=generator) < draw(st.sampled_from([0.0, 0.2, 1.0]))] = NO_THING
    mass = torch.rand(len(levels), generator=generator) * (torch.rand(len(levels), generator=generator) > 0.1)
    things = planted_table(owners, levels, mass)
    things.embeddings[torch.rand(len(levels), generator=generator) < 0.1] = 0  # no view says what they are
    if len(levels) and draw(st.booleans()):
        lost = (owners == int(torch.randint(len(levels), (1,), generator=generator))).any(1)
        things = things.rows(~lost)
    fits = draw(st.sampled_from([0.3, 1.0, 3.0])) * torch.randn(len(levels), 3, generator=generator)
    if draw(st.booleans()):
        fits = fits.round()  # ties
    return things, fits, draw(st.sampled_from([None, None, *range(len(counts))]))


@settings(max_examples=examples(1200))
@given(tables())
def test_the_choice_is_that_of_the_rule(some: tuple[ThingTable, Tensor, int | None]) -> None:
    check_choice(*some)


@settings(max_examples=examples(100))
@given(st.lists(tables(), min_size=2, max_size=6), st.sampled_from([1, 20, 1000]), st.sampled_from([None, 1]))
def test_many_scenes_are_judged_as_each_alone(some: list, at_a_time: int, level: int | None) -> None:
    every, fits = [compared(things) for things, _, _ in some], [fits for _, fits, _ in some]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(matching, "FITS_AT_A_TIME", at_a_time)
        together = choose_things(ThingIndex.joined(every), torch.cat(fits), level)
    alone = [choose_things(one, mine, level) for one, mine in zip(every, fits, strict=True)]
    for text, row in enumerate(together):
        assert [each and vars(each) for each in row] == [
            each[text][0] and vars(each[text][0]) for each in alone
        ]


# How well things fit.


@dataclass(frozen=True, eq=False)
class Asked:
    """A wall, its field with things, and that without."""

    wall: Wall
    field: LanguageField
    bare: LanguageField

    @property
    def things(self) -> ThingTable:
        assert self.field.thing_table is not None
        return self.field.thing_table

    def named(self, number: int, level: int) -> Tensor:
        """The things of a level whose word has this number."""
        of_thing = (self.things.embeddings.float() @ self.wall.vectors.T).argmax(1)
        return ((of_thing == number) & (self.things.levels == level)).nonzero()[:, 0]


@pytest.fixture(scope="module")
def asked() -> Asked:
    wall = planted_wall()
    field = build(wall.gaussians, wall.cameras, wall.regions, SETTINGS)
    return Asked(wall, field, without_things(field))


def test_fits_are_cosines_less_half_of_what_words_reach(asked: Asked) -> None:
    things, texts = asked.things, asked.wall.texts
    for question, words in (
        (texts, texts.everyday),
        (replace(texts, everyday=texts.everyday[:3]), texts.canonical),  # too few to tell
    ):
        known = thing_index(asked.field, question)
        assert known is not None
        fits = known.fits(texts.queries)
        for number, vector in enumerate(things.embeddings.double()):
            cosines = sorted((words.double() @ vector).tolist())
            best = cosines[math.ceil(constants.HUB_QUANTILE * len(words)) - 1]
            doubt = constants.FEW_REGIONS / math.sqrt(int(things.n_regions[number]))
            stability = max(constants.LEAST_STABILITY, float(things.stability[number]))
            doubt -= constants.UNSTABLE * math.log(stability)
            for query, text in enumerate(texts.queries.double()):
                expected = (float(text @ vector) - constants.HUB_SHARE * best) / things.spread - doubt
                assert float(fits[number, query]) == pytest.approx(expected, abs=1e-3)


def test_a_field_compares_its_things_with_words_once(asked: Asked, monkeypatch: pytest.MonkeyPatch) -> None:
    field, texts = asked.field, asked.wall.texts
    first, few = thing_index(field, texts), thing_index(field, replace(texts, everyday=texts.everyday[:3]))
    assert first is not None
    assert thing_index(field, texts.one(1)) is first is not few
    monkeypatch.setattr("scoup.query.thing_judge.THINGS_AT_A_TIME", 5)
    copied = thing_index(copy.deepcopy(field), texts)
    assert copied is not None
    assert copied is not first
    torch.testing.assert_close(copied.best_fits, first.best_fits)
    assert thing_index(asked.bare, texts) is None


# Answers.


def test_things_answer_in_views(asked: Asked) -> None:
    wall = asked.wall
    for camera in wall.cameras:
        shows = wall.shows(camera)
        for number, answer in enumerate(asked.field.at(camera).answer(replace(wall.texts, present_from=0.9))):
            assert answer.presence
            planted = (shows == number)[4:-4]  # without the edge of the wall, behind which is nothing
            mask = answer.mask[4:-4]
            beside = mask & (shows[4:-4] >= 0)
            # But for a column of pixels on either border: Gaussians lie on two of them.
            assert int((beside & planted).sum()) > 0.8 * int((beside | planted).sum())
            assert bool(mask[:, mask.any(0)].all())  # crisp: no hole, no stray


@pytest.mark.parametrize("level", [None, *range(len(LEVELS))])
def test_things_answer_in_the_scene(asked: Asked, level: int | None, monkeypatch) -> None:
    monkeypatch.setattr(constants, "RUNNER_UP", 1e9)
    question = replace(asked.wall.texts, present_from=0.9, level=level)
    for number, answer in enumerate(each_answer(asked.field, question)):
        assert level in (None, LEVELS.index(answer.level))
        expected = asked.named(number, LEVELS.index(answer.level))
        assert sorted(answer.things) == expected.tolist()
        assert answer.mask.equal(asked.things.members(expected))
        assert (answer.presence, answer.threshold) == (True, None)
        assert answer.runner_up is not None
        assert answer.runner_up.thing not in answer.things
        assert (answer.runner_up.score or 0) <= (answer.score or 0)


def test_a_threshold_of_choice_is_for_the_votes(asked: Asked) -> None:
    for present_from in (None, 0.9):
        question = replace(asked.wall.texts, present_from=present_from, threshold=0.4)
        votes = list(each_answer(asked.bare, question))
        for one, other in zip(each_answer(asked.field, question), votes, strict=True):
            assert one.to_dict() == other.to_dict()
            assert (one.threshold, one.things) == (0.4, ())
            shown = [field.at(1).show([each])[0] for field, each in ((asked.field, one), (asked.bare, other))]
            for first, second in ((one, other), shown):
                assert first.mask.equal(second.mask)


def test_a_thing_out_of_sight_is_there_but_not_visible(asked: Asked) -> None:
    """A camera that shows the wall's left end only, asked for the thing at its right end."""
    viewmat = asked.wall.cameras[2].viewmat.clone()
    viewmat[0, 3] += 3.4
    aside = replace(asked.wall.cameras[2], viewmat=viewmat, name="aside.png")
    shows = asked.wall.shows(aside)
    assert bool((shows == 0).any())
    assert not (shows == COUNT - 1).any()
    first, *_, last = asked.field.at(aside).answer(replace(asked.wall.texts, present_from=0.9))
    assert (first.presence, last.presence, first.visible, last.visible) == (True, True, True, False)
    assert "not visible from here" in repr(last)
    assert (last.point, last.box, bool(last.mask.any())) == (None, None, False)


def with_owners(asked: Asked, owners: Tensor) -> LanguageField:
    return altered(asked.field, thing_table=replace(asked.things, owners=owners))


def test_the_point_is_in_the_mask_where_something_else_is_more_relevant(asked: Asked) -> None:
    """The Gaussians of the first thing and of the last have changed places, and relevancy has not."""
    wall, numbers = asked.wall, torch.arange(len(asked.things), dtype=torch.int32)
    for level in range(len(LEVELS)):
        first, last = (asked.named(number, level) for number in (0, COUNT - 1))
        numbers[first], numbers[last] = last.int(), first.int()
    field = with_owners(asked, numbers[asked.things.owners.long()])
    answers, shows = field.at(2).answer(wall.texts), wall.shows(wall.cameras[2])
    for query, there in ((0, COUNT - 1), (COUNT - 1, 0)):
        answer = answers[query]
        assert answer.point is not None
        x, y = answer.point
        assert bool(answer.mask[y, x])
        assert (x > shows.shape[1] // 2) == (there > 0)
        assert bool((shows[:, x] != query).all())
        assert float(answer.heat[y, x]) < float(answer.heat.max())


def test_gaussians_of_no_thing_do_not_count(asked: Asked) -> None:
    """Where a thing contributes among Gaussians of none, such as haze before the camera, the pixels are its own."""
    wall, owners = asked.wall, asked.things.owners.clone()
    scattered = (torch.arange(len(owners)) % 11 == 0) & (wall.thing == 1)
    none = (wall.thing == 1) & ~scattered
    first = owners[(wall.thing == 0) & wall.is_upper][0]
    owners[none] = NO_THING
    owners[scattered] = first
    answer = with_owners(asked, owners).at(2).answer(wall.texts)[0]
    shows = wall.shows(wall.cameras[2])
    border = int((shows[14] == 0).nonzero()[-1]) + 2
    assert (answer.mask & (shows == 1))[:, border:].any()
