"""A field queried in one call, which changes neither the field nor the answers that it gave before."""

from __future__ import annotations

import pickle
import pickletools
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

import scoup
from messages import refuses
from query.conftest import Queried
from query.planted_room import FRONT, planted_room
from scoup import raster
from scoup.base import InputError, MissingFileError, UnknownNameError
from scoup.field import Field
from scoup.models import CANONICAL_PHRASES, TextEncoder, WordTable
from scoup.query.answer import Answer, ExpressionAnswer, answer_relevancy
from scoup.query.ask import each_answer
from scoup.query.language_field import LanguageField
from scoup.query.view_answer import ViewAnswer
from scoup.scene import Detections
from support import altered, unit

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


def assert_same_answer(first: ViewAnswer, second: ViewAnswer) -> None:
    assert first.mask.equal(second.mask)
    assert first.main_parts.equal(second.main_parts)
    assert first.heat.equal(second.heat)
    assert first.to_dict() == second.to_dict()


def test_vectors_and_arrays_are_queries_too(queried: Queried, table: dict[str, Tensor]) -> None:
    field, camera = queried.field.with_encoder(table), queried.camera
    expected = field.at(camera).answer("word 3")
    vector = table["word 3"]
    for same in (vector, vector.numpy(), vector.tolist(), 10 * vector, vector.double() / 99, vector[None]):
        (found,) = field.at(camera).answer(same)
        assert found.text == "query 1"
        assert found.mask.equal(expected.mask)
        torch.testing.assert_close(found.heat, expected.heat, atol=1e-5, rtol=0)
    several = field.at(camera).answer(torch.stack([vector, table["word 4"]]))
    assert [answer.text for answer in several] == ["query 1", "query 2"]
    phrases = {name: table[name].numpy() for name in CANONICAL_PHRASES}
    only = field.at(camera).answer(field.with_encoder(phrases).question(vector))
    assert (only[0].score, only[0].presence) == (None, True)  # four phrases are no words to judge presence by


NAN, ONES = float("nan"), torch.ones(16)
REFUSED: list[Callable[[Any, dict[str, Tensor]], object]] = [
    lambda field, _: field.at(7).answer("word 1"),
    *(lambda field, _, scale=scale: field.at(0, scale) for scale in (0, -1, NAN, float("inf"), "1")),
    lambda field, _: field.gaussian_relevancy("word 1", ["object"]),
    lambda field, _: field.answer([]),
    *(lambda field, _, bad=bad: field.answer(bad) for bad in (NAN * ONES, 0 * ONES, ONES[1:], ONES.expand(2, 2, 16))),
    *(lambda field, _, bad=bad: field.relevancy(0, bad * ONES, ONES) for bad in (NAN, float("inf"), 0)),
    lambda field, _: field.relevancy(0, torch.ones(1, 17), torch.ones(1, 17)),
    lambda field, _: field.gaussian_relevancy(ONES, torch.stack([ONES, 0 * ONES])),
    lambda field, _: field.render_features(0, "x"),
    lambda field, _: field.gaussian_features("xl"),
    lambda field, _: field.question(ONES, level="x"),
    *(lambda field, _, texts=texts: field.question(texts) for texts in (["word 1", 3], 5, None, {"word 1"})),
    *(lambda field, _, bad=bad: field.question("word 1", present_from=bad) for bad in (NAN, "a")),
    lambda field, _: field.question("word 1", threshold="a"),
    lambda field, _: field.with_encoder(3),
    *(lambda field, _, bad=bad: field[bad] for bad in ([True] * 79, torch.tensor([80]), [-1], [[True] * 80])),
    *(lambda field, _, bad=bad: field[bad] for bad in (torch.ones(3), None, "a", {1: 2})),
    lambda field, table: nameless(field).at(field.camera(0)).answer("word 1"),
    lambda field, table: nameless(field).at(0).answer(nameless(field).with_encoder(table).question("word 1")),
]  # fmt: skip


def nameless(field: LanguageField) -> LanguageField:
    """It names no model and contains no cameras."""
    return altered(field, info=replace(field.info, embedding_model=""), cameras=None)


def test_what_cannot_be_asked(field: LanguageField, table: dict[str, Tensor]) -> None:
    for ask in REFUSED:
        with refuses():
            ask(field, table)
    with pytest.raises(InputError, match="must contain vectors"):  # and what torch says of it
        field.with_encoder({"object": "abc"}).question("word 1")  # pyright: ignore[reportArgumentType]
    for ask, name in ((field.answer, "wird 1"), (field.at, "view_09.png")):
        with refuses(UnknownNameError):
            ask(name)
    assert field.camera(np.int64(1)) is field.camera(1)  # pyright: ignore[reportArgumentType]


def test_answers_are_drawn_by_the_field_s_rasteriser(queried: Queried, table: dict[str, Tensor]) -> None:
    field = queried.field
    other = altered(field, info=replace(field.info, raster_preset="gsplat"), thing_table=None)
    answer = other.at(0).answer(other.with_encoder(table).question("word 3", always=True))
    assert answer.source is not None
    expected = raster.render_colors(other.gaussians, queried.camera, other.project(queried.camera))
    assert answer.source.colors().equal(expected)
    copy = pickle.loads(pickle.dumps(answer))
    assert copy.source is None
    assert copy.answer.to_dict() == answer.answer.to_dict()
    assert copy.pictures()["mask"].equal(answer.mask)


def test_a_table_beside_the_file_is_found(queried: Queried, table: dict[str, Tensor], tmp_path: Path) -> None:
    field = queried.field
    WordTable.save(tmp_path / "scene" / "words.npz", list(table), torch.stack(list(table.values())))
    named = altered(field, info=replace(field.info, words=tmp_path / "scene" / "words.npz"))
    named.at(0).answer("word 5")  # what is remembered for views is not saved
    named.save(tmp_path / "scene" / "f.scoup")
    loaded = LanguageField.load(tmp_path / "scene" / "f.scoup")  # the Gaussians are in the file
    other = field.at(0).answer(field.with_encoder(table).question("word 5"))
    loaded.save(tmp_path / "saved.scoup")
    for each in (loaded, LanguageField.load(tmp_path / "saved.scoup")):
        assert_same_answer(each.at(0).answer("word 5"), other)
    part = LanguageField.load(tmp_path / "scene" / "f.scoup")[:40]
    assert part.at(0).answer("word 5").view == queried.camera.name
    moved = (tmp_path / "scene" / "f.scoup").rename(tmp_path / "moved.scoup")
    with refuses(MissingFileError):
        LanguageField.load(moved).answer("word 5")
    assert loaded.to("cpu") is loaded


def test_a_part_of_a_field_is_a_field(queried: Queried, table: dict[str, Tensor], tmp_path: Path) -> None:
    field = queried.field.with_encoder(table)
    mask = torch.arange(len(field)) % 2 == 0
    part = field[mask]
    assert part.fingerprint == field.gaussians.select(mask).fingerprint()
    places = mask.nonzero()[:, 0]
    for same in (mask.numpy(), places, places.int().numpy(), places.tolist()):
        assert field[same].code_weights.equal(part.code_weights)
    vectors = table["word 3"][None], field.encoder.canonical()
    whole = field.gaussian_relevancy(*vectors)
    # Some processors round the last numbers of a vector differently, and where they end depends on the count.
    torch.testing.assert_close(part.gaussian_relevancy(*vectors), whole[..., mask], rtol=1e-6, atol=1e-6)
    assert len(part.answer("word 3").mask) == len(part)
    part.save(tmp_path / "part.scoup")
    loaded = LanguageField.load(tmp_path / "part.scoup", words=table)
    assert loaded.gaussians.fingerprint() == part.fingerprint
    assert_same_answer(loaded.at(0).answer("word 3"), part.at(0).answer("word 3"))
    assert "0 Gaussians" in field[[]]._repr_html_()
    assert field[10:20].fingerprint == field[list(range(10, 20))].fingerprint


@pytest.mark.parametrize("scale", [7.0, 1e-3, 1e20])
def test_relevancy_is_of_directions(queried: Queried, scale: float) -> None:
    field, texts = queried.field, queried.texts
    expected = field.relevancy(queried.camera, texts.queries, texts.canonical)
    found = field.relevancy(queried.camera.name, texts.queries * scale, texts.canonical * max(1.0, scale))
    torch.testing.assert_close(found, expected, atol=2e-6, rtol=0)
    expected = field.gaussian_relevancy(texts.queries, texts.canonical)
    found = field.gaussian_relevancy(np.asarray(texts.queries * scale), texts.canonical)
    torch.testing.assert_close(found, expected, atol=2e-6, rtol=0)


def test_the_mean_of_everyday_words_stays_short(queried: Queried) -> None:
    field, texts = queried.field, queried.texts
    found = field.gaussian_relevancy(texts.queries, texts.with_everyday().canonical)
    mean = texts.everyday.mean(0, keepdim=True)
    assert float(mean.norm()) < 0.9
    other = field.gaussian_relevancy(texts.queries, torch.cat([texts.canonical, unit(mean)]))
    assert not torch.allclose(found, other, atol=1e-4)


def test_a_level_of_ones_own_answers(queried: Queried, table: dict[str, Tensor]) -> None:
    field, texts = queried.field, queried.texts
    for number, level in enumerate(field.levels):
        answer = field.at(queried.camera).answer(replace(texts, level=number))[0]
        assert answer.level == level
        relevancy = field.relevancy(queried.camera, texts.queries, texts.canonical)[number, 0]
        torch.testing.assert_close(answer.heat, relevancy, atol=1e-5, rtol=0)
        place = next(iter(each_answer(field, replace(texts, level=number))))
        assert place.level == level
        own = field.gaussian_relevancy(texts.queries[:1], texts.canonical)[number, 0]
        assert torch.equal(answer_relevancy(field, place), own)
        asked = field.with_encoder(table).question(texts.queries, level=np.int64(number))  # pyright: ignore
        assert asked.level == number
        best = next(iter(each_answer(field, texts)))
        assert best.level != level or best.mask.equal(place.mask)
