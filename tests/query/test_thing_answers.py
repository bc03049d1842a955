"""Things that answer texts: the choice against a plain reading of the rule, and answers in a planted scene."""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from planted_wall import COUNT, DIM, LEVELS, SETTINGS, Wall, planted_wall
from query.conftest import random_vectors, without_things
from scoup.field.language_field import LanguageField
from scoup.query.answer import Answer, SceneAnswer
from scoup.query.answering import answer_scene, answer_view
from scoup.query.known_things import FEW_REGIONS, HUB_QUANTILE, LEAST_STABILITY, UNSTABLE
from scoup.query.presence import UPPER, other_words
from scoup.query.presets import QUERY_PRESETS, QueryPreset
from scoup.query.question import Question
from scoup.query.things import (
    AT_A_TIME,
    HUB_SHARE,
    LEAST_PART,
    LEAST_SCORE,
    MOST_GAP,
    STANDS_OUT,
    VOTES,
    ThingFits,
    choose_things,
    thing_fits,
    thing_of_scene,
)
from scoup.scene.things import NO_THING, ThingTable
from scoup.uplift.build import build
from support import examples, unit


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


@pytest.fixture(scope="module")
def asked() -> Asked:
    wall = planted_wall()
    field = build(wall.gaussians, wall.cameras, wall.regions, SETTINGS, check_fit=False)
    return Asked(wall, field, without_things(field))


def some_things(levels: Sequence[int], agreement: float = 1.0, n_gaussians: int = 4) -> ThingTable:
    count = len(levels)
    return ThingTable(
        torch.full((n_gaussians, 2), NO_THING, dtype=torch.int32),
        torch.tensor(levels, dtype=torch.uint8),
        torch.full((count,), NO_THING, dtype=torch.int32),
        random_vectors(count, 8).half(),
        torch.full((count,), agreement),
        torch.full((count,), 5, dtype=torch.int32),
        torch.ones(count),
        torch.ones(count),
    )


def chosen_of(
    fits: Sequence[float],
    levels: Sequence[int] | None = None,
    mass: Sequence[float] | None = None,
    voted: Sequence[float] | None = None,
    agreement: float = 1.0,
    level: int | None = None,
) -> list[int] | None:
    count = len(fits)
    votes = torch.tensor([0.0] * count if voted is None else voted, dtype=torch.float64)
    found = choose_things(
        some_things([0] * count if levels is None else levels, agreement),
        torch.tensor(fits),
        torch.tensor([1.0] * count if mass is None else mass, dtype=torch.float64),
        votes,
        votes.sum().expand(2),
        level,
    )
    return None if found is None else found.tolist()


# The choice.


def test_one_clear_winner_answers_alone() -> None:
    assert chosen_of([0.0, 3.0, 0.5, 0.1]) == [1]
    # Behind all things of a level stands one like any other; nothing is like the only one there is.
    assert chosen_of([4.0, 0.0, 0.1, 0.2], [0, 1, 1, 1]) == [0]
    assert chosen_of([4.0]) is None


def test_two_that_fit_alike_answer_together_where_a_gap_is_behind_them() -> None:
    assert chosen_of([3.0, 0.0, 3.1, 0.2]) == [2, 0]
    assert chosen_of([3.0, 1.5, 3.1, 0.2]) == [2, 0]


def test_where_no_set_stands_out_the_votes_answer() -> None:
    assert chosen_of([0.3 * number for number in range(12)]) is None


def test_what_is_not_seen_does_not_answer() -> None:
    assert chosen_of([0.0, 3.0, 0.5], mass=[0.0, 0.0, 0.0]) is None
    assert chosen_of([0.0, 9.0, 3.0], mass=[1.0, 0.0, 1.0]) == [2]
    assert chosen_of([0.0, 3.0, 2.9], mass=[1.0, LEAST_PART / 2, 1.0]) == [2]
    assert chosen_of([]) is None


def test_a_level_of_ones_own_answers() -> None:
    fits, levels = [2.0, 0.0, 2.4, 0.5], [0, 0, 1, 1]
    assert chosen_of([2.0, -1.0, 2.4, 1.5], levels) == [0]  # its gap is larger
    assert chosen_of(fits, levels, level=1) == [2]
    assert chosen_of(fits, levels, level=0) == [0]
    assert chosen_of(fits[:2], levels[:2], level=1) is None
    # Where what fits is of another level, the votes know more.
    assert chosen_of([2.0, 0.0, 9.0, 0.5], levels, level=0) is None


def test_the_less_views_agree_the_more_the_votes_count() -> None:
    fits, voted = [3.0, 0.0, 0.0, 0.0, 0.0, 0.0], [0.0, 1.0, 1.0, 1.0, 1.0, 1.0]
    for agreement in (1.0, 0.98, 0.9):
        assert chosen_of(fits, voted=voted, agreement=agreement) == [0]
    assert chosen_of(fits, voted=voted, agreement=0.6) is None
    assert chosen_of(fits, voted=[1.0, 0.0, 0.0, 0.0, 0.0, 0.0], agreement=0.6) == [0]


def literally_chosen(
    things: ThingTable, fits: Tensor, mass: Tensor, voted: Tensor, voted_mass: Tensor, level: int | None
) -> list[list[int]]:
    """All the sets with the best score, most of the time one; [] where the votes answer."""
    whole, weight = float(mass.sum()), VOTES * things.disagreement
    seen = [
        number
        for number in range(len(things))
        if float(mass[number]) > LEAST_PART * whole and bool(things.embeddings[number].any())
    ]
    top = max((float(fits[number]) for number in seen), default=0.0)
    in_order = sorted(float(fits[number]) for number in seen)
    middle = in_order[(len(seen) - 1) // 2] if seen else 0.0
    scores: list[tuple[float, list[int]]] = []
    for each in range(things.owners.shape[1]):
        mine = [number for number in seen if int(things.levels[number]) == each and level in (None, each)]
        mine.sort(key=lambda number: -float(fits[number]))
        for size in range(1, len(mine) + 1):
            chosen = mine[:size]
            last = float(fits[mine[size - 1]])
            behind = last - (float(fits[mine[size]]) if size < len(mine) else min(middle, last))
            area = sum(float(mass[n]) for n in chosen)
            mean = sum(float(mass[n]) * float(fits[n]) for n in chosen) / area
            inside = sum(float(voted[n]) for n in chosen)
            overlap = inside / max(1e-9, area + float(voted_mass[each]) - inside)
            scores.append((min(behind, MOST_GAP) - (top - mean) + weight * overlap, chosen))
    best = max((score for score, _ in scores), default=-math.inf)
    if best <= LEAST_SCORE + weight + 1e-6:
        return [] if best < LEAST_SCORE + weight - 1e-6 else [[], *(each for _, each in scores)]
    return [chosen for score, chosen in scores if score > best - 1e-6]


@settings(max_examples=examples(1200), deadline=None)
@given(
    st.integers(0, 2**31), st.integers(0, 12), st.sampled_from([1.0, 0.9, 0.3]),
    st.sampled_from([None, None, 0, 1]), st.sampled_from([0.3, 1.0, 3.0]),
)  # fmt: skip
def test_the_choice_is_that_of_the_rule(
    seed: int, count: int, agreement: float, level: int | None, scale: float
) -> None:
    generator = torch.Generator().manual_seed(seed)
    levels = torch.randint(2, (count,), generator=generator).sort().values
    things = some_things(levels.tolist(), agreement)
    things.embeddings[torch.rand(count, generator=generator) < 0.1] = 0  # no view says what they are
    fits = scale * torch.randn(count, generator=generator)
    mass = torch.rand(count, generator=generator, dtype=torch.float64) * 100
    mass[torch.rand(count, generator=generator) < 0.2] = 0
    voted = mass * torch.rand(count, generator=generator, dtype=torch.float64)
    voted_mass = torch.tensor([float(voted[levels == each].sum()) + 10 * each for each in range(2)]).double()
    found = choose_things(things, fits, mass, voted, voted_mass, level)
    expected = literally_chosen(things, fits, mass, voted, voted_mass, level)
    assert ([] if found is None else found.tolist()) in (expected or [[]])


# How well things fit.


def at_quantile(cosines: Tensor, quantile: float = HUB_QUANTILE) -> float:
    """The smallest of them that is as large as 99 of 100, or more."""
    return sorted(cosines.tolist())[math.ceil(quantile * len(cosines)) - 1]


def test_fits_are_cosines_less_half_of_what_words_reach(asked: Asked) -> None:
    things, texts = asked.things, asked.wall.texts
    fits = ThingFits.of(things, texts)
    embeddings = things.embeddings.double()
    for number in range(len(things)):
        best = at_quantile(texts.everyday.double() @ embeddings[number])
        for query, vector in enumerate(texts.queries.double()):
            cosine = float(vector @ embeddings[number])
            assert float(fits.cosines[number, query]) == pytest.approx(cosine, abs=1e-5)
            doubt = FEW_REGIONS / math.sqrt(int(things.n_regions[number]))
            doubt -= UNSTABLE * math.log(max(LEAST_STABILITY, float(things.stability[number])))
            expected = (cosine - HUB_SHARE * best) / things.spread - doubt
            assert float(fits.fits[number, query]) == pytest.approx(expected, abs=1e-3)
    few = replace(texts, everyday=texts.everyday[:3])  # too few to tell
    assert ThingFits.of(things, few).to_words.shape == (len(things), len(texts.canonical))


def test_presence_is_the_lead_over_words_and_over_things(asked: Asked) -> None:
    things, texts = asked.things, asked.wall.texts
    fits = ThingFits.of(things, texts)
    for query in range(COUNT):
        own = fits.fits[:, query].double()
        best = int(own.argmax())
        counted = other_words(texts.queries[query : query + 1], texts.everyday)[0]
        words = texts.everyday[counted].double() @ things.embeddings[best].double()
        lead = (float(fits.cosines[best, query]) - at_quantile(words, UPPER)) / words.std(correction=0)
        expected = float(lead + (own[best] - own.mean()) / own.std() - STANDS_OUT)
        assert fits.presence(query) == pytest.approx(expected, abs=1e-3)
        seen = torch.zeros(len(things), dtype=torch.bool)
        assert fits.presence(query, seen) == -math.inf
        seen[best] = True
        assert fits.presence(query, seen) == pytest.approx(expected, abs=1e-3)
        others = fits.presence(query, ~seen & (own < own[best] - 1))
        assert others < expected - 1


def test_what_is_present_comes_before_what_is_not(asked: Asked) -> None:
    texts = asked.wall.texts
    absent = unit(texts.everyday.mean(0, keepdim=True) + random_vectors(6, DIM, seed=7))
    both = replace(texts, texts=tuple("abcdefghij"), queries=torch.cat([texts.queries, absent]))
    fits = ThingFits.of(asked.things, both)
    found = [fits.presence(query) for query in range(10)]
    assert min(found[:COUNT]) > max(found[COUNT:]) + 1.5


def test_other_names_of_a_text_take_nothing_from_its_presence(asked: Asked) -> None:
    texts = asked.wall.texts
    # As many words as an encoder knows, of which the synonyms are more than the twentieth that may fit better.
    words = torch.cat([texts.everyday, unit(texts.everyday.mean(0) + random_vectors(400, DIM, seed=3))])
    plain = replace(texts, everyday=words)
    synonyms = unit(texts.queries[:1] + 0.02 * random_vectors(30, DIM, seed=4))
    more = replace(texts, everyday=torch.cat([words, synonyms]))
    one, other = (ThingFits.of(asked.things, each) for each in (plain, more))
    assert not other.others[0, -30:].any()
    assert other.others[1:, -30:].all()
    assert other.presence(0) == pytest.approx(one.presence(0), abs=0.3)
    kept = replace(other, others=torch.ones_like(other.others))
    assert kept.presence(0) < one.presence(0) - 2


def test_as_many_things_as_files_hold_fit_as_many_words_as_tables_hold() -> None:
    """More pairs than torch takes quantiles of at once."""
    count, n_words = 17_000, 1000
    things = ThingTable(
        torch.full((1, 1), NO_THING, dtype=torch.int32),
        torch.zeros(count, dtype=torch.uint8),
        torch.full((count,), NO_THING, dtype=torch.int32),
        random_vectors(count, 4).half(),
        torch.ones(count),
        torch.full((count,), 5, dtype=torch.int32),
        torch.ones(count),
        torch.ones(count),
    )
    texts = Question(("a",), random_vectors(1, 4), random_vectors(4, 4, seed=1), random_vectors(n_words, 4))
    assert ThingFits.of(things, texts).fits.shape == (count, 1)


# Answers.


def check_whole(answer: Answer, relevancy: Tensor) -> None:
    """Mask, point, box and heat are of one thing at one level."""
    assert answer.presence
    assert answer.mask.any()
    assert answer.point is not None
    x, y = answer.point
    assert bool(answer.mask[y, x])
    assert bool(answer.main_parts[y, x])
    assert not (answer.main_parts & ~answer.mask).any()
    rows, columns = answer.main_parts.any(1).nonzero(), answer.main_parts.any(0).nonzero()
    expected = int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1
    assert answer.box == expected
    assert answer.heat.equal(relevancy[LEVELS.index(answer.level)])
    assert answer.coverage == pytest.approx(float(answer.mask.float().mean()))


def test_things_answer_in_views(asked: Asked) -> None:
    field, wall = asked.field, asked.wall
    for camera in wall.cameras:
        answers = answer_view(field, camera, replace(wall.texts, present_from=1.5))
        maps = field.relevancy(camera, wall.texts.queries, wall.texts.canonical)
        shows = wall.shows(camera)
        for number, answer in enumerate(answers):
            check_whole(answer, maps[:, number])
            assert answer.threshold is None  # no threshold of relevancy made it
            planted = (shows == number)[4:-4]  # without the edge of the wall, behind which is nothing
            mask = answer.mask[4:-4]
            beside = mask & (shows[4:-4] >= 0)
            # But for a column of pixels on either border: Gaussians lie on two of them.
            assert int((beside & planted).sum()) > 0.8 * int((beside | planted).sum())
            for row in mask[:, mask.any(0)]:  # crisp: no hole, no stray
                assert bool(row.all())


def test_things_answer_in_the_scene(asked: Asked) -> None:
    field, wall, things = asked.field, asked.wall, asked.things
    of_thing = (things.embeddings.float() @ wall.vectors.T).argmax(1)
    for number, answer in enumerate(answer_scene(field, replace(wall.texts, present_from=1.5))):
        level = LEVELS.index(answer.level)
        expected = things.members(((of_thing == number) & (things.levels == level)).nonzero()[:, 0])
        assert answer.mask.equal(expected)
        assert (answer.presence, answer.threshold) == (True, None)
        own = field.gaussian_relevancy(wall.texts.queries[number : number + 1], wall.texts.canonical)
        assert answer.relevancy.equal(own[level, 0])
        assert answer.score == float(own[level, 0][answer.mask].max())
        fits = ThingFits.of(things, wall.texts)
        found = thing_of_scene(fits, number, answer.mask)
        assert found is not None
        assert found[0].equal(expected)


@pytest.mark.parametrize("number", range(len(LEVELS)))
def test_a_level_of_ones_own_answers_with_its_things(asked: Asked, number: int) -> None:
    field, wall, things = asked.field, asked.wall, asked.things
    of_thing = (things.embeddings.float() @ wall.vectors.T).argmax(1)
    maps = field.relevancy(wall.cameras[2], wall.texts.queries, wall.texts.canonical)
    answers = answer_view(field, 2, replace(wall.texts, level=number))
    for query, answer in enumerate(answers):
        check_whole(answer, maps[:, query])
        assert (answer.level, answer.threshold) == (LEVELS[number], None)
    for query, place in enumerate(answer_scene(field, replace(wall.texts, level=number))):
        mine = (of_thing == query) & (things.levels == number)
        assert place.mask.equal(things.members(mine.nonzero()[:, 0]))
        assert (place.level, place.threshold) == (LEVELS[number], None)


def same_view(one: Answer, other: Answer) -> None:
    assert one.mask.equal(other.mask)
    assert one.main_parts.equal(other.main_parts)
    assert one.heat.equal(other.heat)
    assert one.record() == other.record()


def same_scene(one: SceneAnswer, other: SceneAnswer) -> None:
    assert one.mask.equal(other.mask)
    assert one.relevancy.equal(other.relevancy)
    assert one.record() == other.record()


@pytest.mark.parametrize(
    "preset",
    [
        *(each for name, each in QUERY_PRESETS.items() if name != "default"),
        replace(QUERY_PRESETS["default"], threshold=0.5),
        replace(QUERY_PRESETS["default"], level_choice="mask"),
    ],
    ids=lambda each: f"{each.name}-{each.threshold}-{each.level_choice}",
)
def test_rules_of_choice_are_for_the_votes(asked: Asked, preset: QueryPreset) -> None:
    for present_from in (None, 1.0):
        question = replace(asked.wall.texts, preset=preset, present_from=present_from)
        ours = answer_view(asked.field, 1, question)
        for one, other in zip(ours, answer_view(asked.bare, 1, question), strict=True):
            same_view(one, other)
            assert one.threshold is not None


@pytest.mark.parametrize("how", [{"threshold": 0.4}, {"neighbours": 5}, {"rescaled": False}], ids=str)
def test_selections_of_choice_are_for_the_votes(asked: Asked, how: dict) -> None:
    for present_from in (None, 1.0):
        question = replace(asked.wall.texts, present_from=present_from, **how)
        ours = answer_scene(asked.field, question)
        votes = answer_scene(asked.bare, question)
        for one, other in zip(ours, votes, strict=True):
            same_scene(one, other)
            assert one.threshold is not None


def test_texts_are_answered_alike_alone_and_together(asked: Asked) -> None:
    """Also where there are more than one pass takes."""
    wall = asked.wall
    more = torch.cat([wall.texts.queries, unit(wall.vectors + 0.5 * wall.vectors.roll(1, 0)), wall.vectors])
    texts = replace(
        wall.texts, texts=tuple(f"word {i}" for i in range(len(more))), queries=more, present_from=1.0
    )
    assert len(more) > AT_A_TIME + 1
    together = answer_view(asked.field, 3, texts)
    in_scene = answer_scene(asked.field, texts)
    for number, (in_view, place) in enumerate(zip(together, in_scene, strict=True)):
        one = texts.one(number)
        (alone,) = answer_view(asked.field, 3, one)
        assert in_view.mask.equal(alone.mask)
        assert (in_view.level, in_view.threshold is None) == (alone.level, alone.threshold is None)
        assert in_view.z_score == pytest.approx(alone.z_score, abs=1e-3)
        (alone_in_scene,) = answer_scene(asked.field, one)
        assert place.mask.equal(alone_in_scene.mask)
        assert place.z_score == pytest.approx(alone_in_scene.z_score, abs=1e-3)


def test_a_thing_out_of_sight_does_not_answer(asked: Asked) -> None:
    """A camera that shows the wall's left end only, asked for the thing at its right end."""
    viewmat = asked.wall.cameras[2].viewmat.clone()
    viewmat[0, 3] += 3.4
    aside = replace(asked.wall.cameras[2], viewmat=viewmat, name="aside.png")
    shows = asked.wall.shows(aside)
    assert bool((shows == 0).any())
    assert not (shows == COUNT - 1).any()
    *_, last = answer_view(asked.field, aside, replace(asked.wall.texts, present_from=1.5))
    first, *_ = answer_view(asked.field, aside, replace(asked.wall.texts, present_from=1.5))
    assert first.presence
    assert not last.presence
    assert last.point is None
    assert not last.mask.any()


def with_owners(asked: Asked, owners: Tensor) -> LanguageField:
    field = asked.field
    return LanguageField(
        field.code_indices, field.code_weights, field.codebook, field.info, asked.wall.gaussians,
        cameras=field.cameras, thing_table=replace(asked.things, owners=owners),
    )  # fmt: skip


def test_the_point_is_in_the_mask_where_something_else_is_more_relevant(asked: Asked) -> None:
    """The Gaussians of the first thing and of the last have changed places, and relevancy has not."""
    wall, things = asked.wall, asked.things
    of_thing = (things.embeddings.float() @ wall.vectors.T).argmax(1)
    numbers = torch.arange(len(things), dtype=torch.int32)
    first, last = (of_thing == 0).nonzero()[:, 0], (of_thing == COUNT - 1).nonzero()[:, 0]
    numbers[first], numbers[last] = last.int(), first.int()  # of each level in their order
    field = with_owners(asked, numbers[things.owners.long()])
    maps = field.relevancy(wall.cameras[2], wall.texts.queries, wall.texts.canonical)
    answers = answer_view(field, 2, wall.texts)
    shows = wall.shows(wall.cameras[2])
    for query, there in ((0, COUNT - 1), (COUNT - 1, 0)):
        answer = answers[query]
        assert answer.threshold is None
        check_whole(answer, maps[:, query])
        assert answer.point is not None
        x, y = answer.point
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
    answer = answer_view(with_owners(asked, owners), 2, wall.texts)[0]
    assert answer.threshold is None
    beside = answer.mask & (wall.shows(wall.cameras[2]) == 1)
    beside[:, : int((wall.shows(wall.cameras[2])[14] == 0).nonzero()[-1]) + 2] = False  # the border
    assert beside.any()


def test_a_field_compares_its_things_with_words_once(asked: Asked) -> None:
    field, texts = asked.field, asked.wall.texts
    first = thing_fits(field, texts)
    again = thing_fits(field, texts.one(1))
    assert first is not None
    assert again is not None
    assert again.known is first.known
    torch.testing.assert_close(again.fits, first.fits[:, 1:2])
    few = thing_fits(field, replace(texts, everyday=texts.everyday[:3]))
    copied = thing_fits(copy.deepcopy(field), texts)
    assert few is not None
    assert copied is not None
    assert few.known is not first.known
    assert copied.known is not first.known
    assert torch.equal(copied.fits, first.fits)
