"""Answers of scenes and of views: what they say, their records and crops."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from PIL import Image

from messages import refuses
from query.conftest import ASKED, Queried
from scoup.query.answer import Answer, RunnerUp, answer_relevancy
from scoup.query.answer_scene import each_answer
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
    assert not shown.mask.any()
    assert (shown.visible, shown.point, shown.box, shown.coverage, shown.position) == (
        False, None, None, 0.0, None,
    )  # fmt: skip
    assert shown.heat.max() > 0.5  # the heat map says how near it is all the same


def test_records_contain_no_infinity() -> None:
    mask = torch.arange(40) < 12
    answer = Answer("mug", mask, "s", 0.61234567, ASKED, True, (3, 1), (0.6, 0.5), RunnerUp(2, None))
    record = answer.to_dict()
    assert " ".join(record) == "gaussians things level score certainty present runner_up"
    assert [*record.values()] == [12, [3, 1], "s", 0.6123, "likely", True, {"thing": 2, "score": None}]
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
