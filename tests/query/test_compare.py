"""Changes between two captures of a known room."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from messages import refuses, warns
from query.planted_room import BACK, FRONT, ROOM, Box, Similarity, planted_room
from scoup.base import ScoupWarning, WorldFrame
from scoup.query.comparison import compare
from scoup.query.language_field import LanguageField
from scoup.scene import Camera, Cameras

WORDS = [*dict.fromkeys(box.name for box in ROOM)]
MUG, LAPTOP, LAMP = 1, 3, 4
AWAY = Camera.look_at((0, 60, 1), (0, 70, 1), "away.png", 64, 48, 50)
TURN = torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]).double()


def without(field: LanguageField, *things: int) -> LanguageField:
    """The field without some things; it knows the same words."""
    assert field.thing_table is not None
    return field[~field.thing_table.members(torch.tensor(things))]


def changes(old: LanguageField, new: LanguageField, transform: np.ndarray | None = None) -> set[tuple]:
    """Kind and numbers of each change; those that are sure."""
    found = compare(old, new, WORDS, transform).changes
    assert all(change.confidence > 0.5 for change in found)
    return {(each.kind, each.old and each.old.number, each.new and each.new.number) for each in found}


@pytest.mark.parametrize("camera", [FRONT, BACK])
def test_what_is_gone_and_what_is_new(camera: Camera) -> None:
    room, less = planted_room(), without(planted_room(cameras=[camera]), LAMP, LAPTOP)
    assert changes(room, less) == {("removed", LAMP, None), ("removed", LAPTOP, None)}
    assert changes(less, room) == {("added", None, LAMP), ("added", None, LAPTOP)}
    assert changes(room, planted_room(cameras=[camera])) == set()


def test_what_no_camera_sees_is_neither_gone_nor_new() -> None:
    room = planted_room()
    blind = without(planted_room(cameras=[AWAY]), LAMP)
    assert changes(room, blind) == {("unseen", LAMP, None)}
    assert changes(blind, room) == {("unseen", None, LAMP)}


@pytest.mark.parametrize("is_known", [True, False])
def test_how_far_a_thing_moved_in_another_frame(is_known: bool) -> None:
    lamp = Box("lamp", (0.9, 0, 1.8), (0.3, 0.3, 0.3))
    boxes = [lamp if box.name == "lamp" else box for box in ROOM]
    frame = Similarity(TURN, 3.0, torch.tensor([5.0, -4.0, 2.0]).double())
    back = np.eye(4)
    back[:3, :3] = TURN.numpy().T / 3
    back[:3, 3] = -back[:3, :3] @ frame.shift.numpy()
    old, new = planted_room(is_rough=True), planted_room(boxes, moved=frame, is_rough=True)
    comparison = compare(old, new, WORDS, back if is_known else None)
    registration = comparison.registration
    assert registration.source == ("transform passed" if is_known else "registered")
    assert registration.transform == pytest.approx(back, abs=1e-5)
    assert (registration.agreeing, registration.things) == (14, 15)  # all but the lamp
    (change,) = comparison.changes
    assert (change.kind, change.distance) == ("moved", pytest.approx(np.hypot(0.9, 0.2), rel=0.01))
    known = None if not is_known else back
    record = compare(old.with_world(WorldFrame(2.0)), new, WORDS, known).to_dict()["changes"][0]
    assert record["distance_metres"] == pytest.approx(2 * record["distance"], rel=1e-4)
    for side, metres in (("old", 2), ("new", 2 / 3)):
        extent = record[side]["box"]["extent"]
        assert record[side]["extent_metres"] == pytest.approx([metres * each for each in extent], rel=1e-3)


SOFA = Box("sofa", (0, 0, 1), (2, 1, 1))
HALVES = Box("sofa", (-0.5, 0, 1), (1, 1, 1)), Box("sofa", (0.5, 0, 1), (1, 1, 1))
CUPS = tuple(Box("cup", (side, 0, 1), (0.3, 0.3, 0.3)) for side in (-1, 1))


@pytest.mark.parametrize(("old", "new"), [([SOFA], HALVES), (CUPS, CUPS[::-1])])
def test_what_is_cut_or_numbered_in_another_way_did_not_change(old, new) -> None:
    for one, other in ((old, new), (new, old)):
        assert not compare(planted_room(one), planted_room(other), [old[0].name]).changes


def test_a_capture_without_things_that_count_can_be_compared() -> None:
    room, bare = planted_room(), planted_room()
    assert room.thing_table is not None
    owners = torch.where(torch.arange(len(room))[:, None] % 40 == 0, room.thing_table.owners, -1)
    bare.thing_table = replace(room.thing_table, owners=owners.int())
    assert bare.things() == []
    for one, other in ((room, bare), (bare, room)):
        with warns(ScoupWarning):
            assert not changes(one, other, np.eye(4))  # what is of no thing may be anything


def shifted(*by: float) -> LanguageField:
    return planted_room(moved=Similarity(torch.eye(3).double(), 1, torch.tensor(by).double()))


def test_frames_are_the_same_only_if_the_gaussians_fit() -> None:
    room = planted_room()
    for by in ((0.0, 0.0, 0.0), (0.0, 0.02, 0.0), (500.0, 500.0, 500.0)):
        registration = compare(room, shifted(*by), WORDS).registration
        assert registration.source == ("registered" if any(by) else "same frame")
        assert registration.transform[:3, 3] == pytest.approx(np.array(by) * -1, abs=1e-3)
        assert registration.residual == pytest.approx(0, abs=1e-3)


def test_captures_that_cannot_be_compared() -> None:
    room, blind, other = planted_room(), planted_room(), planted_room()
    blind.cameras = Cameras([])
    other.info = type(other.info)(("m",), "other", other.fingerprint, len(other))
    for refused in (without(planted_room(), *range(3, 15)), planted_room(has_things=False), blind, other):
        with refuses():
            compare(shifted(0, 3, 0), refused, WORDS)
    with warns(ScoupWarning):
        compare(room, shifted(0, 1.5, 0), WORDS, np.eye(4))
