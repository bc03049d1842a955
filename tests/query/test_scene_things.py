"""Things as objects: those of a table, those of a selection, their places against a naive loop, and their names."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from planted_wall import COUNT, SETTINGS, planted_wall
from query.conftest import ASKED, without_things
from query.planted_room import ABSENT, ROOM, Box, planted_room, with_whole
from scoup.field import NO_THING, ThingTable
from scoup.field.thing_table import TENSORS
from scoup.query import constants
from scoup.query.answer import Answer, ExpressionAnswer
from scoup.query.boxes import OrientedBox, PointSets
from scoup.query.catalog import draw_things, viewing_cameras
from scoup.query.expression import parse_expression
from scoup.query.language_field import LanguageField, build
from scoup.query.thing_names import _broader as broader
from scoup.query.thing_names import best_of_trees, broader_words, find_objects, thing_names
from scoup.query.things import Thing
from scoup.scene import Camera, Gaussians
from support import altered, examples, gaussians_at


@pytest.fixture(scope="module")
def room() -> LanguageField:
    return planted_room()


def test_every_thing_is_where_its_box_is(room) -> None:
    found = {thing.number: thing for thing in room.things()}
    for number, box in enumerate(ROOM):
        thing = found[number]
        assert (thing.text, thing.score, thing.parent, thing.n_regions) == ("", None, None, 9)
        assert thing.gaussians.tolist() == (room.thing_table.owners[:, 0] == number).nonzero()[:, 0].tolist()
        spacing, middle = torch.tensor(box.size).double() / 6, torch.tensor(box.middle).double()
        assert bool(((thing.position - middle).abs() <= 0.51 * spacing).all())
        extent, expected = thing.box.extent.sort().values, (5 * spacing).sort().values
        torch.testing.assert_close(extent, expected, rtol=0.25, atol=1e-3)
        assert thing.to_dict()["gaussians"] == thing.n_gaussians == 216
        assert not any(name.endswith("_metres") for name in thing.to_dict())
        assert thing.describe().endswith(" scene units")
        assert repr(thing).startswith(f"Thing(thing {number} at [")


def test_what_fits_better_comes_first() -> None:
    field = planted_room([Box("mug", (0, 0, 0), (1, 1, 1)), Box("mug", (3, 0, 0), (1, 1, 1))])
    assert field.thing_table is not None
    field.thing_table.n_regions[0] = 4  # seen less often
    assert [thing.number for thing in field.things("mug")] == [1, 0]


def test_things_of_two_levels_have_parents_that_contain_them() -> None:
    wall = planted_wall()
    field = build(wall.gaussians, wall.cameras, wall.regions, SETTINGS)
    things = {thing.number: thing for thing in field.things()}
    parts = [thing for thing in things.values() if thing.level == "s"]
    assert len(parts) == 2 * COUNT
    assert list(things) == [*range(3 * COUNT)]
    for part in parts:
        whole = things[part.parent]
        assert (whole.level, whole.parent) == ("m", None)
        assert set(part.gaussians.tolist()) <= set(whole.gaussians.tolist())
    texts = wall.texts
    for number in range(COUNT):
        (found,) = field.things(texts.one(number, level=1))
        assert (found.text, found.level) == (texts.texts[number], "m")
        assert (wall.thing[found.gaussians] == number).float().mean() > 0.9
        (voted,) = without_things(field).things(texts.one(number))
        assert (voted.number, voted.score, voted.parent) == (None, None, None)
        assert (wall.thing[voted.gaussians] == number).float().mean() > 0.9


def test_without_a_table_connected_parts_answer_and_strays_do_not() -> None:
    boxes = [*ROOM, Box("mug", (0, -3, 3), (0.001, 0.001, 0.001))]
    field = planted_room(boxes, has_things=False)
    assert field.things() == []
    assert len(field.things("mug")) == 3
    field.gaussians.opacities[216 * len(ROOM) : 216 * len(boxes)] = 0.01  # light beside the others
    assert sorted(round(float(thing.position[0])) for thing in field.things("mug")) == [-1, 1]


def test_a_table_of_no_things_leaves_the_votes(room) -> None:
    table = room.thing_table
    no_owners = torch.full_like(table.owners, NO_THING)
    nothing = ThingTable(no_owners, *(getattr(table, name)[:0] for name in TENSORS[1:]))
    field = altered(room, thing_table=nothing, words=room.words)
    assert field.things() == []
    assert [thing.number for thing in field.things("mug")] == [None, None]
    assert field.catalog(["mug", "laptop"]).to_dict()["things"] == []
    field = altered(room, thing_table=replace(table, owners=no_owners), words=room.words)
    assert field.things("mug") == []
    assert field.catalog(["mug", "laptop"]).things == ()
    answer = field.answer(field.question("mug", always=True))
    assert (answer.presence, answer.score, bool(answer.mask.any())) == (True, 0, False)


def test_where_nothing_was_found_an_answer_says_so() -> None:
    nothing, tree = torch.zeros(3, dtype=torch.bool), parse_expression("not mug")
    mug = Answer("mug", nothing, "m", 0.0, ASKED, False)
    absent = ExpressionAnswer("not mug", nothing, "m", 0.0, ASKED, False, tree=tree, parts=(mug,))
    assert absent.remark() == "nothing found"


def test_a_thing_around_a_camera_has_no_picture_and_ends_nothing(room) -> None:
    mug, *others = room.things()[1:4]
    camera = Camera.look_at(mug.position, mug.position + torch.eye(3)[1], "inside", 64, 48, 50)
    assert viewing_cameras(mug, [camera]) == []
    drawn = [thing.number for thing, *_ in draw_things(room, [mug, *others], [camera])]
    assert others[0].number in drawn
    assert mug.number not in drawn


# Places against a naive loop. Opacities are multiples of 1/16 and coordinates are whole, so that sums are exact.


def naive_median(values: list[float], weights: list[float]) -> float:
    reached = 0.0
    for value, weight in sorted(zip(values, weights, strict=True)):
        reached += weight
        if reached >= 0.5 * sum(weights):
            return value
    return max(values)


def naive_points(gaussians: Gaussians, rows: list[int]) -> list[tuple[list[float], float]]:
    """Means and weights of one thing without strays."""
    every = [(gaussians.means[row].tolist(), float(gaussians.opacities[row])) for row in rows]
    there = [(mean, min(weight, 1.0)) for mean, weight in every if np.isfinite(mean).all() and weight > 0]
    if not there:
        return []
    weights = [weight for _, weight in there]
    middle = [naive_median([mean[axis] for mean, _ in there], weights) for axis in range(3)]
    distances = [float(np.linalg.norm(np.subtract(mean, middle))) for mean, _ in there]
    farthest = constants.FARTHEST * naive_median(distances, weights)
    return [one for one, distance in zip(there, distances, strict=True) if distance <= farthest]


coordinates = st.one_of(st.integers(-6, 6).map(float), st.sampled_from([50.0, float("nan"), float("inf")]))
odd = st.sampled_from([0.0, float("nan"), float("inf"), 2.0, -1.0])
opacities = st.one_of(st.integers(0, 16).map(lambda part: part / 16), odd)
clouds = st.lists(st.tuples(coordinates, coordinates, coordinates, opacities), max_size=25)


@settings(max_examples=examples(200), deadline=None)
@given(cloud=clouds, owners=st.lists(st.integers(0, 4), min_size=25, max_size=25))
def test_points_of_things_are_those_of_a_naive_loop(cloud, owners) -> None:
    numbers = torch.tensor(cloud, dtype=torch.float32).reshape(-1, 4)
    gaussians = replace(gaussians_at(numbers[:, :3]), opacities=numbers[:, 3])
    members = [[row for row in range(len(cloud)) if owners[row] == thing] for thing in range(5)]
    points = PointSets.of(gaussians, [torch.tensor(rows, dtype=torch.int64) for rows in members])
    boxes = points.boxes(torch.tensor([0.0, 0.6, 0.8]).double())
    for thing, rows in enumerate(members):
        expected = naive_points(gaussians, rows)
        assert points.of_one(thing).tolist() == [mean for mean, _ in expected]
        assert points.weights[points.owners == thing].tolist() == [weight for _, weight in expected]
        assert (boxes[thing] is None) == (not expected)


LAMP = 4  # of ROOM


def test_a_word_names_only_what_it_finds() -> None:
    field = planted_room()
    names = thing_names(field, field.question(["mug", "laptop", ABSENT]))
    wanted = {number: box.name for number, box in enumerate(ROOM) if box.name in ("mug", "laptop")}
    assert {number: name.texts[0] for number, name in names.items()} == wanted
    assert thing_names(field, field.question([ABSENT])) == {}


def test_of_many_words_a_broader_one_names_a_thing(monkeypatch) -> None:
    monkeypatch.setattr(constants, "SHORT_LIST", 0)
    monkeypatch.setattr(constants, "IN_COMMON", 2)
    field = planted_room()
    monkeypatch.setattr("scoup.query.thing_names.broader_words", lambda: {
        "vessel": frozenset(["cup", "mug", "vase"]), "crockery": frozenset(["cup", "mug"]),
    })  # fmt: skip
    assert broader(["vase", "mug", "cup", "sock"]) == ("crockery", "mug", "cup")  # the narrower of two
    assert broader(["vase", "sock", "mug", "shoe"]) == ("vessel", "vase", "mug")
    assert broader(["vase", "sock", "boot", "shoe"]) == ()
    assert broader(["vessel", "mug", "vase", "shoe"]) == ("vessel", "mug", "vase")
    names = thing_names(field, field.question(["mug", "laptop", ABSENT]))
    assert {name.texts for name in names.values()} == {()}  # nothing in common


def test_broader_words() -> None:
    words = broader_words()
    assert {"boot", "sandal"} <= words["footwear"]
    assert min(map(len, words.values())) >= 3
    assert list(words) == sorted(words)


def thing(number: int, parent: int | None, score: float | None, size: int, regions: int = 9) -> Thing:
    box = OrientedBox(torch.zeros(3).double(), torch.eye(3).double(), torch.ones(3).double())
    position, gaussians = torch.zeros(3).double(), torch.arange(size)
    return Thing(number, "m", parent, "", None, position, box, gaussians, regions, word_score=score)


@pytest.mark.parametrize(("tree", "objects"), [
    ([(0, None, 0.9, 100), (1, 0, 0.8, 60), (2, 0, 0.8, 40)], [0]),  # an object better named than its parts
    ([(0, None, 0.7, 100), (1, 0, 0.9, 50), (2, 0, 0.9, 50)], [1, 2]),  # a group of better named objects
    ([(0, None, 0.7, 100), (1, 0, 0.9, 30)], [0]),  # what has a name is a small part
    ([(0, None, None, 100), (1, 0, 0.9, 90)], [1]),
    ([(0, None, None, 100), (1, 0, constants.UNNAMED + 0.1, 50)], [0]),
    ([(0, None, None, 100), (1, 0, None, 100)], [0]),
    ([(0, 7, 0.5, 100)], [0]),  # its parent is not listed
])  # fmt: skip
def test_objects_are_the_best_named_level_of_each_tree(tree: list[tuple], objects: list[int]) -> None:
    assert [each.number for each in best_of_trees([thing(*each) for each in tree])] == objects


@pytest.mark.parametrize(("regions", "stability", "again", "name", "is_object"), [
    (9, constants.STABLE, False, "", True), (9, constants.STABLE - 0.1, False, "", False),
    (9, constants.STABLE - 0.1, True, "", True),  # another level has it, too
    (constants.LEAST_REGIONS - 1, constants.STABLE, True, "", False), (1, 0.0, False, "lamp", True),
])  # fmt: skip
def test_fragments_without_a_name_are_no_objects(regions, stability, again, name, is_object) -> None:
    room = planted_room()
    assert room.thing_table is not None
    room.thing_table.n_regions[:], room.thing_table.stability[:] = regions, stability
    field, whole = with_whole(room, [LAMP]) if again else (room, LAMP)
    things = [replace(each, text=name) for each in field.things()]
    assert (whole in {each.number for each in find_objects(field, things)}) == is_object


def test_a_part_is_folded_into_a_whole_beyond_the_next_level() -> None:
    field, whole = with_whole(planted_room(), [1, 2])
    assert field.thing_table is not None
    field.thing_table.parents[:] = NO_THING
    objects = {thing.number for thing in find_objects(field, field.things())}
    assert objects & {1, 2, whole} == {whole}
