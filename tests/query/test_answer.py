"""Answers of scenes and of views: what they say, their records and crops, and copies in other processes."""

from __future__ import annotations

import copy
import json
import pickle
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

from children import workers
from messages import refuses
from query.conftest import ASKED, WORDS, Queried, random_vectors
from scoup.models import TextEncoder, WordTable
from scoup.query.answer import Answer, RunnerUp, answer_relevancy
from scoup.query.ask import each_answer
from scoup.query.language_field import LanguageField
from scoup.query.view_answer import ViewAnswer
from scoup.query.votes import select_each


@pytest.mark.parametrize("threshold", [0.5, None])
def test_answers_of_the_votes(voted: Queried, threshold: float | None) -> None:
    field, question = voted.field, replace(voted.texts, threshold=threshold)
    found = list(select_each(field, question))
    for each, answer in zip(found, list(each_answer(field, question)), strict=True):
        assert answer.mask.equal(each.mask)
        assert answer_relevancy(field, answer).equal(each.relevancy)
        assert (answer.level, answer.threshold) == (field.levels[each.level], each.threshold)
        assert (answer.presence, answer.things, answer.runner_up) == (True, (), None)
        record = json.loads(json.dumps(answer.to_dict(), allow_nan=False))
        assert record["gaussians"] == int(each.mask.sum())
        assert record["threshold"] == pytest.approx(each.threshold, abs=1e-3)


def test_what_is_absent_has_neither_mask_nor_point(queried: Queried) -> None:
    (answer,) = queried.field.answer(replace(queried.texts, present_from=1.0).one(0))
    assert (answer.presence, answer.certainty, answer.things) == (False, "not here", ())
    assert "not in this scene" in repr(answer)
    (shown,) = queried.field.at(queried.camera).show([answer])
    assert (shown.visible, bool(shown.mask.any()), shown.coverage) == (False, False, 0)
    assert (shown.point, shown.box, shown.position) == (None, None, None)
    assert shown.heat.max() > 0.5  # the heat map says how near it is all the same


def test_records_contain_no_infinity() -> None:
    mask = torch.arange(40) < 12
    answer = Answer("mug", mask, "s", 0.61234567, ASKED, True, (3, 1), (0.6, 0.5), RunnerUp(2, None))
    record = answer.to_dict()
    assert " ".join(record) == "gaussians count things level score certainty present runner_up"
    assert [*record.values()] == [12, 2, [3, 1], "s", 0.6123, "likely", True, {"thing": 2, "score": None}]
    nothing = torch.zeros(2, 3, dtype=torch.bool)
    shown = ViewAnswer(replace(answer, score=None), "a.png", nothing, nothing.float(), nothing, None, None)
    record = shown.to_dict()
    assert " ".join(record) == "level score certainty present visible pixel coverage box position"
    assert [*record.values()] == ["s", None, None, True, False, None, 0.0, None, None]
    assert shown.remark() == "not visible from here"


@pytest.mark.parametrize(("score", "presence", "said"), [
    (None, True, None), (0.95, True, "sure"), (0.9, True, "sure"), (0.6, True, "likely"), (0.59, True, "doubtful"),
    (0.95, False, "not here"), (0.0, False, "not here"),
])  # fmt: skip
def test_certainty(score: float | None, presence: bool, said: str | None) -> None:
    assert Answer("mug", torch.ones(1, dtype=torch.bool), "s", score, ASKED, presence).certainty == said


def test_the_crop_follows_the_box() -> None:
    mask = torch.zeros(20, 30, dtype=torch.bool)
    mask[5:9, 10:16] = True
    answer = Answer("mug", torch.ones(1, dtype=torch.bool), "s", 0.9, ASKED)
    shown = ViewAnswer(answer, "a.png", mask, mask.float(), mask, (10, 5, 16, 9), (12, 6))
    image = torch.arange(600).view(20, 30)
    picture = Image.fromarray(np.zeros((20, 30, 3), np.uint8))
    cut, wide, drawn = shown.crop(image), shown.crop(image, margin=12), shown.crop(picture)
    assert torch.equal(cut, image[5:9, 10:16])  # pyright: ignore[reportArgumentType]
    assert [getattr(each, "shape", None) for each in (wide, drawn)] == [(20, 28), (4, 6, 3)]
    assert replace(shown, box=None).crop(image) is None
    for wrong, margin in ((image[1:], 0), (image.T, 0), (image, -1)):
        with refuses():
            shown.crop(wrong, margin)


COPIES = {"pickle": lambda value: pickle.loads(pickle.dumps(value)), "deepcopy": copy.deepcopy}


@pytest.mark.parametrize("copied", COPIES.values(), ids=COPIES)
def test_fields_and_what_they_answer(field: LanguageField, copied: Callable[[Any], Any]) -> None:
    expected = field.location("word 3").to_dict()  # and something is kept
    field.at(0).answer("word 3")
    other = copied(field)
    assert other.location("word 3").to_dict() == expected
    assert len(other.cache) == 3  # its own comparison of things with words, question and answer
    question = field.question(["word 1", "word 2"], threshold=0.6)
    found, wanted = other.location(copied(question)), field.location(question)
    assert [each.to_dict() for each in found] == [each.to_dict() for each in wanted]
    answers = field.answer("word 3"), field.select("word 3 and not word 4"), field.answer("largest word 3")
    for made in (*answers, field.location("word 3")):
        assert copied(made).to_dict() == made.to_dict()
        if isinstance(made, Answer):  # a copy knows its vectors: any field that it fits shows it
            again = copied(made)
            assert again.remark() == made.remark()
            assert answer_relevancy(other, again).equal(answer_relevancy(field, made))
            seen, expected_seen = other.at(0).show([again])[0], field.at(0).show([made])[0]
            assert seen.to_dict() == expected_seen.to_dict()
            assert seen.mask.equal(expected_seen.mask)
            assert other.location(again).to_dict() == field.location(made).to_dict()
    labels = field.label(["word 1", "word 2"])
    assert copied(labels).ids.equal(labels.ids)


@pytest.mark.parametrize("copied", COPIES.values(), ids=COPIES)
def test_encoders(tmp_path: Path, copied: Callable[[Any], Any]) -> None:
    vectors = random_vectors(len(WORDS), 16, seed=5)
    WordTable.save(tmp_path / "words.npz", WORDS, vectors)
    for encoder in (
        TextEncoder.open(dict(zip(WORDS, vectors, strict=True))),
        TextEncoder.open(tmp_path / "words.npz"),
        TextEncoder("model", 16, _ones),
    ):
        other = copied(encoder)
        assert (other.name, other.dim, other.names) == (encoder.name, encoder.dim, encoder.names)
        assert other.encode(["word 3"]).equal(encoder.encode(["word 3"]))
    encoder.close()
    with refuses():
        copied(encoder).encode(["word 3"])


def _ones(phrases: list[str]) -> torch.Tensor:
    return torch.ones(len(phrases), 16)


def _located(field: LanguageField, text: str) -> dict[str, Any]:
    return field.location(text).to_dict()


def test_other_processes_ask(field: LanguageField) -> None:
    with workers(1) as pool:
        assert pool.submit(_located, field, "word 3").result() == _located(field, "word 3")
