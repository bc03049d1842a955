"""Relations in a room whose boxes are known, however the room is turned, moved and scaled."""

from __future__ import annotations

import math
from itertools import permutations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from messages import refuses
from query.planted_room import BACK, FRONT, ROOM, Box, Similarity, planted_room, with_whole
from scoup.base import UnknownNameError
from scoup.models import TextEncoder
from scoup.query.ask import apart
from scoup.query.language_field import LanguageField
from scoup.query.phrases import explained, parse_phrase
from scoup.query.question import literal
from scoup.query.relations import CONDITIONS, Shapes, resolve, touching_things
from support import examples

TABLE, LEFT, RIGHT, LAPTOP, LAMP, BALL, BOWL, APPLE, PEN = range(9)
TRUTH: dict[str, set[int]] = {
    "mug left of the laptop": {LEFT}, "mug right of the laptop": {RIGHT}, "mug in front of the laptop": {LEFT},
    "mug behind the laptop": {RIGHT}, "mug left of mug": {LEFT}, "laptop between mug and mug": {LAPTOP},
    "mug between laptop and bowl": set(), "laptop between pen and mug": {LAPTOP}, "mug on the table": {LEFT, RIGHT},
    "table on mug": set(), "lamp on the table": set(), "lamp above the table": {LAMP},
    "mug above the table": {LEFT, RIGHT}, "lamp above the laptop": {LAMP}, "laptop above the lamp": set(),
    "laptop under the lamp": {LAPTOP}, "lamp under the laptop": set(), "ball under the table": {BALL},
    "mug under the table": set(), "apple inside the bowl": {APPLE}, "bowl inside the apple": set(),
    "mug inside the bowl": set(), "pen near the laptop": {PEN}, "mug near the laptop": set(), "mug near mug": set(),
    "mug nearest to the pen": {RIGHT}, "mug nearest to the bowl": {LEFT}, "laptop nearest to laptop": set(),
    "largest mug": {RIGHT}, "smallest mug": {LEFT}, "second largest mug": {LEFT}, "third largest mug": set(),
    "mug from the left": {LEFT}, "second mug from the left": {RIGHT}, "first mug from the right": {RIGHT},
    "mug from the back": {RIGHT}, "mug from the front": {LEFT}, "mug from the top": {RIGHT},
    "mug from the bottom": {LEFT}, "largest mug left of the laptop": {LEFT},
    "mug left of the laptop under the lamp": {LEFT}, "mug left of the laptop right of the lamp": set(),
    "mug left of unicorn": set(), "unicorn left of mug": set(), "largest unicorn": set(),
}  # fmt: skip
"""By phrase, the things that are meant; relations first, then the order."""


@pytest.fixture(scope="module")
def room() -> LanguageField:
    return planted_room()


def numbers(field: LanguageField, text: str, camera: str = FRONT.name) -> list[int | None]:
    return [thing.number for thing in field.things(field.question(text, frame=field.frame(camera)))]


@pytest.mark.parametrize("text", TRUTH)
def test_relations_of_a_known_room(room, text) -> None:
    found = numbers(room, text)
    assert set(found) == TRUTH[text]
    assert len(found) == len(set(found))
    selected = room.select(room.question(text, frame=room.frame(FRONT.name))).mask
    assert torch.equal(selected, room.thing_table.members(torch.tensor(found, dtype=torch.int64)))


@pytest.mark.parametrize("text", ["left of", "right of", "in front of", "behind"])
def test_from_behind_all_sides_change(room, text) -> None:
    expected = {LEFT, RIGHT} - TRUTH[f"mug {text} the laptop"]
    assert set(numbers(room, f"mug {text} laptop", BACK.name)) == expected
    assert set(numbers(room, f"mug {text} laptop")) != expected


@settings(max_examples=examples(12), deadline=None)
@given(
    seed=st.integers(0, 999),
    scale=st.sampled_from([0.01, 0.5, 1.0, 30.0]),
    shift=st.lists(st.floats(-20, 20), min_size=3, max_size=3),
)
def test_relations_stay_in_a_room_turned_scaled_and_moved(seed, scale, shift) -> None:
    turn = torch.from_numpy(np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0])
    turn = turn * torch.linalg.det(turn)
    moved = planted_room(moved=Similarity(turn, scale, scale * torch.tensor(shift, dtype=torch.float64)))
    for text in list(TRUTH)[seed % 2 :: 2]:
        assert set(numbers(moved, text)) == TRUTH[text], text


@pytest.mark.parametrize("text", ["lamp above the laptop", "mug left of the laptop", "apple inside the bowl"])
def test_connected_parts_have_relations_too(text) -> None:
    bare = planted_room(has_things=False)
    (found,) = bare.things(bare.question(text, frame=bare.frame(FRONT.name)))
    (number,) = TRUTH[text]
    assert math.dist(found.position.tolist(), ROOM[number].middle) < 0.1


def test_things_of_expressions(room) -> None:
    for asked, expected in (
        ("mug or laptop or mug", [LEFT, RIGHT, LAPTOP]),
        (["laptop", "mug left of laptop"], [LAPTOP, LEFT]),
        ("mug and not mug left of laptop", [RIGHT]),
    ):
        assert [thing.number for thing in room.things(asked)] == expected
    assert [thing.number for thing in room.things("not (word 0 or table)")][:2] == [LEFT, RIGHT]
    either = room.select("(mug left of laptop) or ball and not apple").mask
    assert set(room.thing_table.owners[either, 0].tolist()) == {LEFT, BALL}


def test_words_that_are_not_known_are_named(room) -> None:
    with refuses():
        room.things("mug beyond the laptop")
    with refuses(UnknownNameError):
        room.things("mug left of the dragon")
    for text in (
        "the red Mug",
        "two mugs",
        "tallest pen behind the laptop",
        '"mug on the table"',
        "red dragon",
    ):
        with refuses(UnknownNameError):
            room.things(text)
    named = TextEncoder.open({"mug": [1.0, 0], "red": [0, 1.0]})
    with refuses(UnknownNameError):
        raise explained(UnknownNameError("text", "red mug", ["mug"], "", "ask it, or use a model"), named)
    with refuses(UnknownNameError):
        room.label(literal(["red mug"]))


@pytest.mark.parametrize("height", [0.02, 0.3])
def test_a_thing_hangs_until_it_touches(height) -> None:
    """Of two boxes one above the other, the upper is on the lower one only without a gap."""
    lower = Box("desk", (0, 0, 0.95), (2, 2, 0.1))
    upper = Box("cup", (0.2, 0.1, 1.0 + height + 0.1), (0.2, 0.2, 0.2))
    field = planted_room([lower, upper])
    assert numbers(field, "cup above desk") == [1]
    assert numbers(field, "cup on desk") == ([1] if height < 0.1 else [])


@pytest.mark.parametrize(("shift", "is_above"), [(0.1, True), (0.5, True), (0.9, False), (1.1, False)])
def test_above_needs_a_quarter_of_a_footprint(shift, is_above) -> None:
    field = planted_room([Box("desk", (0, 0, 1), (1, 1, 0.1)), Box("lamp", (shift, 0, 2), (1, 1, 0.3))])
    assert bool(numbers(field, "lamp above desk")) == bool(numbers(field, "desk under lamp")) == is_above


def test_what_stands_on_the_lower_end_of_something_tall_is_not_under_it() -> None:
    """Its bottom is near to both ends of the other, in units of the taller one's height."""
    tall, low = Box("shelf", (0, 0, 0.75), (0.4, 0.4, 1.5)), Box("book", (0, 0, 0.3), (0.3, 0.3, 0.3))
    field = planted_room([tall, low])
    assert numbers(field, "book above shelf") == numbers(field, "book on shelf") == [1]
    assert numbers(field, "shelf under book") == [0]
    assert numbers(field, "shelf above book") == numbers(field, "book under shelf") == []


@pytest.mark.parametrize(("count", "relation"), [(2, "on"), (216, "inside")])
def test_misplaced_gaussians_make_no_container_of_a_table(count: int, relation: str) -> None:
    """Of eight clouds around a cup few Gaussians are taken for the table, or all are its, as of a rim."""
    places = [
        (0.4 * math.cos(angle), 0.4 * math.sin(angle), 1.15) for angle in (np.arange(8) + 0.5) * np.pi / 4
    ]
    rim = [Box("rim", place, (0.05, 0.05, 0.2)) for place in places]
    table, cup = Box("table", (0, 0, 0.95), (1, 1, 0.1)), Box("cup", (0, 0, 1.15), (0.3, 0.3, 0.3))
    field = planted_room([table, cup, *rim])
    assert field.thing_table is not None
    field.thing_table.owners[2 * 216 : 10 * 216].view(8, 216)[:, 216 - count :] = 0
    assert [each for each in field.relations() if each[0] == 1] == [(1, relation, 0)]


@pytest.mark.parametrize("field", [planted_room(), with_whole(planted_room(), [LEFT, LAPTOP, PEN])[0]])
def test_things_that_are_near_enough_are_all_that_touch(field: LanguageField) -> None:
    shapes = Shapes.of(field, field.things(), field.frame())
    every = list(permutations(range(len(shapes.things)), 2))
    found = {(one, other): holds for one, other, *holds in touching_things(shapes)}
    wanted = {
        pair: [CONDITIONS[name](shapes, pair[0], pair[1:]) for name in ("inside", "on")] for pair in every
    }
    assert 0 < len(found) < len(every)
    assert {pair: holds for pair, holds in wanted.items() if any(holds)} == {
        pair: holds for pair, holds in found.items() if any(holds)
    }


def test_what_no_thing_satisfies_is_not_there() -> None:
    field = planted_room()
    found = field.answer(field.question("mug and table", always=True))
    assert (found.presence, found.things, field.things("mug and table")) == (False, (), [])
    assert field.answer("not mug").score is None
    assert field.frame() is field.frame() is not field.frame("back.png")  # found once


@pytest.mark.parametrize(("phrase", "found"), [("ball on the bowl", {1}), ("bowl on the ball", set())])
def test_what_a_level_takes_for_one_thing_is_told_apart(phrase: str, found: set[int]) -> None:
    """At level m a ball and its bowl are one thing, which answers both words; their parts do if no level was asked."""
    boxes = [Box("bowl", (0, 0, 0.02), (0.4, 0.4, 0.04)), Box("ball", (0, 0, 0.14), (0.2, 0.2, 0.2))]
    field, both = with_whole(planted_room(boxes), [0, 1])
    words = field.question(["ball", "bowl"], level="m")
    of_texts = {word: field.things(words.one(number)) for number, word in enumerate(words.texts)}
    assert [[thing.number for thing in things] for things in of_texts.values()] == [[both]] * 2
    target = parse_phrase(phrase)
    parts = apart(field, words, target, of_texts)
    assert {thing.number for thing in resolve(field, target, parts, field.frame())} == found
    assert not field.things(field.question(phrase, level="m"))
