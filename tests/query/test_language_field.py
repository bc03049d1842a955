"""Fields and answers are data: a question changes neither its field nor the answers that it gave before."""

from __future__ import annotations

import pickle
import pickletools
from collections.abc import Callable, Sequence
from dataclasses import fields
from typing import Any

import numpy as np
import torch

import scoup
from query.planted_room import FRONT, planted_room
from scoup.field import Field
from scoup.models import TextEncoder
from scoup.query.answer import Answer, ExpressionAnswer
from scoup.query.language_field import LanguageField
from scoup.scene import Detections

LAMP = 4  # of the room


class Lamps:
    """A model that sees a lamp all over each picture."""

    def to_dict(self) -> dict[str, str]:
        return {"concepts": "lamps"}

    def detect(self, image: np.ndarray, texts: Sequence[str]) -> Detections:
        height, width = image.shape[:2]
        box = torch.tensor([[0.0, 0.0, width, height]])
        return Detections(torch.zeros(1, dtype=torch.long), torch.tensor([0.8]), box, (width, height))


def state(field: LanguageField) -> tuple[list[Any], list[torch.Tensor]]:
    """What a field refers to, and copies of its tensors."""
    parts = [*field.parts(), field.words, field.encoder, field.info, field.gaussians, field.path]
    return parts, [part.clone() for part in parts if isinstance(part, torch.Tensor)]


ASKED: dict[str, Callable[[LanguageField], Any]] = {
    "answer": lambda field: field.answer(["mug", "largest mug", "lamp and not mug"]),
    "view": lambda field: field.at(FRONT).answer("mug left of the laptop"),
    "location": lambda field: field.location("lamp"),
    "select": lambda field: field.select("mug and not lamp", scoup.Reshaping(grow=1)),
    "things": lambda field: field.things("what is on the table"),
    "label": lambda field: field.label(["mug", "lamp"]),
    "catalog": lambda field: field.catalog(["mug", "lamp"]),
    "names": lambda field: field.naming_question(),
    "refine": lambda field: scoup.refine(field, "lamp", Lamps()),
    "encoder": lambda field: field.with_encoder({name: torch.ones(32) for name in ("object", "lamp")}),
}


def test_a_question_leaves_the_field_as_it_is() -> None:
    field = planted_room()
    parts, tensors = state(field)
    for name, ask in ASKED.items():
        ask(field)
        others, after = state(field)
        assert [id(part) for part in others] == [id(part) for part in parts], name
        assert all(one.equal(other) for one, other in zip(tensors, after, strict=True)), name


def test_other_words_and_names_make_other_fields_of_the_same_tensors() -> None:
    field = planted_room()
    before = field.answer("lamp").to_dict()
    encoder = field.encoder
    known = dict(zip(encoder.names or (), encoder.encode(encoder.names or ()), strict=True))
    swapped = field.with_encoder({**known, "lamp": known["mug"], "mug": known["lamp"]})
    named = scoup.refine(field, "lamp", Lamps()).field
    for other in (swapped, named):
        assert other.cache is not field.cache
        for name in ("code_indices", "code_weights", "codebook", "gaussians", "info", "cameras", "path"):
            assert getattr(other, name) is getattr(field, name), name
    assert swapped.thing_table is field.thing_table
    assert swapped.answer("mug").things == (LAMP,)
    assert named.encoder is encoder
    assert named.thing_table is not None
    assert getattr(named.thing_table.names, "texts", None) == ("lamp",)
    assert getattr(field.thing_table, "names", "") is None
    assert field.answer("lamp").to_dict() == before


def test_words_are_opened_at_the_first_text_and_kept() -> None:
    field = planted_room()
    assert (type(field.words), type(field.encoder)) == (dict, TextEncoder)
    for other in (field, field[:20], field.with_encoder(field.encoder)):
        assert other.encoder is field.encoder
    data = Field(field.code_indices, field.code_weights, field.codebook, field.info, field.gaussians)
    assert not hasattr(data, "answer")
    assert LanguageField.of(data, field.words).answer("lamp").mask.any()


def test_answers_contain_neither_a_field_nor_an_encoder() -> None:
    assert len(fields(Answer)) == 10
    content = pickle.dumps(planted_room().answer(["mug", "largest mug", "lamp and not mug"]))
    classes = {argument for _, argument, _ in pickletools.genops(content)}
    assert {"ExpressionAnswer", "AskedText"} <= classes
    assert not classes & {"LanguageField", "Field", "TextEncoder"}


def test_phrases_and_expressions_have_answers_with_a_tree_and_parts() -> None:
    room = planted_room()
    assert type(room.answer("mug")) is Answer
    found = room.answer("lamp and not mug left of the laptop")
    assert isinstance(found, ExpressionAnswer)
    assert (found.tree.wanted, found.tree.excluded) == (("lamp",), ("mug", "laptop"))
    assert [part.text for part in found.parts] == ["lamp", "mug", "laptop"] == list(found.tree.texts)
    for part in found.parts:
        assert part.to_dict() == room.answer(part.text).to_dict()
        assert part.mask.equal(room.answer(part.text).mask)
    assert [thing.number for thing in found.found] == list(found.things) == [LAMP]
    assert found.scores == room.answer("lamp").scores
    assert (len(found.without), found.seen_from) == (1, FRONT.name)
    assert isinstance(room.select("mug"), ExpressionAnswer)
    assert [part.text for part in room.select(["mug", "lamp"]).parts] == ["mug", "lamp"]
