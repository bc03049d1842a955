"""Names of things, and the things that are one object each."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from query.planted_room import ABSENT, ROOM, planted_room, with_whole
from scoup.query import constants
from scoup.query.boxes import OrientedBox
from scoup.query.thing_names import best_of_trees, find_objects, thing_names
from scoup.query.things import Thing
from scoup.scene.things import NO_THING

LAMP = 4  # of ROOM


def test_a_word_names_only_what_it_finds() -> None:
    field = planted_room()
    names = thing_names(field, field.question(["mug", "laptop", ABSENT]))
    wanted = {number: box.name for number, box in enumerate(ROOM) if box.name in ("mug", "laptop")}
    assert {number: name.texts[0] for number, name in names.items()} == wanted
    assert thing_names(field, field.question([ABSENT])) == {}


def thing(number: int, parent: int | None, score: float | None, size: int, regions: int = 9) -> Thing:
    box = OrientedBox(torch.zeros(3).double(), torch.eye(3).double(), torch.ones(3).double())
    name = "" if score is None else "mug"
    return Thing(number, "m", parent, name, score, torch.zeros(3).double(), box, torch.arange(size), regions)


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
def test_fragments_without_a_name_are_no_objects(
    regions: int, stability: float, again: bool, name: str, is_object: bool
) -> None:
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
