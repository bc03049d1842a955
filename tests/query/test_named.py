"""Names that a model gave: the rule that joins its votes with the field's answer, refinement on demand, files."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from cli_support import run_json
from messages import refuses
from query.planted_room import BACK, FRONT, ROOM, Box, planted_room
from scoup.field import NameTable
from scoup.models import TextEncoder, WordTable
from scoup.query import constants
from scoup.query.language_field import LanguageField
from scoup.query.matching import Choice
from scoup.query.named import Named, joined
from scoup.query.refinement import choose_views, refine
from scoup.query.thing_judge import thing_index
from scoup.scene import Camera, Cameras, Detections
from scoup.uplift.constants import EVEN_SCORE
from scoup.uplift.naming import things_in_view
from support import altered

MUG, OTHER_MUG, LAPTOP, LAMP, BALL = 1, 2, 3, 4, 5  # of ROOM


def names_of(votes: dict[str, dict[int, float]], presence: Mapping[str, float] | float = 0.9) -> NameTable:
    pairs = [(row, thing, vote) for row, of in enumerate(votes.values()) for thing, vote in of.items()]
    rows, things, values = zip(*pairs, strict=True)
    sure = [presence[text] if isinstance(presence, Mapping) else presence for text in votes]
    rows, things = torch.tensor([rows, things], dtype=torch.int32)
    return NameTable(tuple(votes), torch.tensor(sure), rows, things, torch.tensor(values))


def named_room(votes: dict[str, dict[int, float]], presence: float = 0.9) -> LanguageField:
    return with_names(planted_room(), names_of(votes, presence))


def with_names(field: LanguageField, names: NameTable) -> LanguageField:
    assert field.thing_table is not None
    return altered(field, thing_table=replace(field.thing_table, names=names), words=field.words)


@pytest.mark.parametrize(("votes", "sure", "things"), [
    ({LAMP: 0.6}, constants.LIKELY - 0.01, {MUG, OTHER_MUG}),  # the field alone
    ({MUG: 0.3, LAMP: 0.3 / (constants.AGREES + 0.1)}, 0.9, {MUG}),  # they agree; a mug without votes is left out
    ({MUG: 0.3, OTHER_MUG: 0.3 * (constants.TOGETHER + 0.01)}, 0.9, {MUG, OTHER_MUG}),
    ({LAMP: 0.6, MUG: 0.02}, 0.8, {LAMP}),
    ({LAMP: 0.6, BALL: 0.6 * (constants.TOGETHER + 0.2), LAPTOP: 0.02}, 0.9, {LAMP, BALL}),
])  # fmt: skip
def test_votes_and_the_field_answer_together(votes: dict[int, float], sure: float, things: set[int]) -> None:
    answer = named_room({"mug": votes}, sure).answer("mug")
    assert set(answer.things) == things
    assert answer.presence
    assert bool(answer.mask.any())


def test_votes_for_things_that_do_not_count_decide_nothing() -> None:
    room = named_room({"mug": {MUG: 0.6}})
    assert room.thing_table is not None
    part = room[room.thing_table.owners[:, 0] != MUG]
    assert [thing.number for thing in part.things("mug")] == [OTHER_MUG]
    # Most things fit as well as the best one, and another one has all votes.
    boxes = (*(Box("mug", (k - 4.0, 0, 1.1), (0.3, 0.3, 0.3)) for k in range(12)), ROOM[LAMP])
    room = with_names(planted_room(boxes), names_of({"mug": {12: 0.6}}, 0.9))
    assert room.answer("mug").things == (12,)


def test_presence_joins_the_odds_of_the_photographs_and_of_the_field() -> None:
    named = Named(names_of({"mug": {MUG: 0.4, LAMP: 0.1}}, presence=0.8), 0, 6)
    assert named.score() == pytest.approx(named.score(0.5)) == pytest.approx(0.8)
    assert named.score(0.9) == pytest.approx(1 - 1 / (1 + 4 * 9**constants.FIELD_POWER))
    assert named.score(0.0) == named.score(0.01) > 0
    assert named.score(0.9, LAMP) == pytest.approx(named.score(0.9) / 4)
    field = named_room({"lamp": {LAMP: 0.02}}, presence=0.1)
    assert field.answer("lamp").presence is False
    assert field.answer("laptop").presence, "of a text without a name it is the field's"


def test_things_that_fit_badly_are_lowered() -> None:
    """Two things with equal votes: the one that fits the text like the median thing counts less than half as much."""
    field = planted_room()
    known = thing_index(field, field.question("mug"))
    assert known is not None
    fits, votes = torch.ones(len(known.counts)), torch.zeros(len(known.counts))
    fits[[LAMP, BALL, MUG]] = torch.tensor([4.5, 1.0, 5.0])
    votes[[LAMP, BALL]] = 0.5
    chosen = joined(Choice((MUG,), 0, 5.0, None), votes, known.levels, known.usable, fits)
    assert (chosen.things, chosen.runner_up, chosen.fit) == ((LAMP,), MUG, 4.5)


def test_a_text_near_to_a_name_is_answered_by_it() -> None:
    field = planted_room()
    words = {word: field.encoder.encode([word])[0] for word in field.encoder.names or ()}
    words["luminaire"] = torch.nn.functional.normalize(words["lamp"] + 0.02 * words["ball"], dim=0)
    named = named_room({"Luminaire": {BALL: 0.5}}).with_encoder(words)  # whatever its capitals
    assert named.answer("luminaire").things == (BALL,)
    assert named.answer("lamp").things == (BALL,)
    assert named.answer("laptop").things == (LAPTOP,)


def test_names_come_first_in_catalogues_and_lists() -> None:
    field = named_room({"ball": {LAMP: 0.5}, "pen": {MUG: 0.01}})
    by_number = {
        thing.number: thing.text for thing in field.catalog(["lamp", "ball", "mug", "laptop"]).things
    }
    assert (by_number[LAMP], by_number[MUG], by_number[LAPTOP]) == ("ball", "mug", "laptop")
    assert {thing.number: thing.text for thing in field.things()}[LAMP] == "ball"
    assert field.catalog(["lamp", "mug"]).things[LAMP].text == "lamp", "only words of the list are names"


def test_a_name_that_a_model_gave_is_tried_once() -> None:
    field = named_room({"Lamp": {LAMP: 0.5}, "lamps": {BALL: 0.5}, "ufo": {BALL: 0.5}})
    assert field.naming_question().texts == field.encoder.vocabulary()
    field = field.with_encoder(TextEncoder("", 32, lambda phrases: torch.ones(len(phrases), 32)))
    texts = field.naming_question().texts
    assert [texts.count(text) for text in ("lamp", "Lamp", "lamps", "ufo")] == [1, 0, 1, 1]


class Finder:
    """A model that sees a box where a thing of the room is, of whatever it is asked."""

    def __init__(self, field: LanguageField, thing: int, score: float = 0.8) -> None:
        assert field.thing_table is not None
        self.looked: list[tuple[int, ...]] = []
        self.score = score
        seen = (things_in_view(field.gaussians, field.thing_table, view, "inria") for view in (FRONT, BACK))
        self.boxes = [each.boxes[thing] for each in seen]

    def to_dict(self) -> dict[str, str]:
        return {"concepts": "finder"}

    def detect(self, image: np.ndarray, texts: Sequence[str]) -> Detections:
        box = self.boxes[len(self.looked)]
        self.looked.append(image.shape)
        rows = torch.arange(len(texts))
        return Detections(rows, torch.full((len(rows),), self.score), box.repeat(len(rows), 1), (64, 48))


def test_on_demand_the_thing_that_the_model_sees_answers_or_none() -> None:
    field = planted_room()
    model = Finder(field, BALL)
    refined = refine(field, "lamp", model).field
    assert model.looked == [(48, 64, 3)] * 2, "both cameras were rendered at their size"
    assert refined.answer("lamp").things == (BALL,)
    assert field.answer("lamp").things == (LAMP,), "the field that was refined has not changed"
    score = refined.answer("lamp").score or 0
    assert constants.LIKELY < score < 0.8 / (0.8 + EVEN_SCORE), "the ball hardly fits a lamp"
    both = refine(refined, ["mug on the table", "mug"], Finder(field, LAPTOP))
    assert both.texts == ("mug", "table"), "those of a phrase, each once"
    assert both.field.answer(["lamp", "table"])[0].things == (BALL,), "names of before stay"
    with refuses():
        refine(planted_room(has_things=False), "lamp", model)
    said = refine(field, ["lamp"], Finder(field, BALL, score=0.001))
    assert not said.field.answer("lamp").presence
    assert said.describe().startswith("looked for lamp in 0 photographs and 2 rendered views, ")


def test_views_show_what_may_answer() -> None:
    """Of three cameras, two of which look away, the one that sees the room is chosen first."""
    away = [Camera.look_at((0, -5, 1), (0, -9, 1), f"away {number}.png", 64, 48, 50) for number in range(2)]
    field, cameras = planted_room(), Cameras([*away, FRONT])
    assert [camera.name for camera in choose_views(field, ["mug"], cameras, 1)] == ["front.png"]
    assert len(choose_views(field, ["mug"], cameras, 9)) == 3


def test_the_verb_asks_what_the_model_sees(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    field, path, words = planted_room(), tmp_path / "room.scoup", tmp_path / "words.npz"
    field.save(path, weight_bits=8)
    names = field.encoder.names or ()
    WordTable.save(words, names, field.encoder.encode(names))
    monkeypatch.setattr("scoup.query.refinement.open_concepts", lambda name, device: Finder(field, BALL))
    query = ("query", path, "lamp", "--text", words, "--pictures", "none")
    # The second time, the file has not changed.
    for thing, options in ((BALL, ("--refine", "owlv2")), (LAMP, ())):
        said = run_json(*query, "--out", tmp_path / str(thing), "--camera", "all", *options)
        assert ('"rendered": 2' in json.dumps(said)) == (thing == BALL)
        assert said["places"][0]["things"] == [thing]
        expected = (refine(field, "lamp", "owlv2").field if options else field).answer("lamp")
        judged = [
            {of[key] for of in said["places"] + said["answers"]} for key in ("score", "present", "certainty")
        ]
        assert judged == [{round(expected.score or 0, 4)}, {expected.presence}, {expected.certainty}]
