"""Answers in views and in scenes against their parts."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from PIL import Image
from torch import Tensor

from query.conftest import Queried
from scoup.base.errors import InputError
from scoup.models.words import LEAST_WORDS
from scoup.query.answer import Answer, SceneAnswer
from scoup.query.answering import answer_scene, answer_view
from scoup.query.localize import best_pixel
from scoup.query.presence import scene_z_scores, view_z_scores, with_evidence
from scoup.query.presets import QUERY_PRESETS
from scoup.query.segment import main_parts, mask_box, segment
from scoup.query.select import select_each
from scoup.query.things import ThingFits, things_of_view


@pytest.mark.parametrize("name", QUERY_PRESETS)
def test_an_answer_is_point_and_mask(voted: Queried, name: str) -> None:
    """Of one level, and the point lies in the mask, where that has a pixel."""
    preset, field, texts = QUERY_PRESETS[name], voted.field, voted.texts
    maps = field.relevancy(voted.camera, texts.queries, texts.canonical, field.project(voted.camera))
    answers = answer_view(field, voted.camera, replace(texts, preset=preset))
    assert len(answers) == len(texts.queries)
    for relevancy, answer in zip(maps.unbind(1), answers, strict=True):
        shape = segment(relevancy, preset)
        assert answer.mask.equal(shape.mask)
        assert (answer.coverage, answer.score) == (shape.coverage, shape.score)
        assert answer.point is not None
        x, y = answer.point
        among = shape.smoothed[shape.mask] if shape.mask.any() else shape.smoothed
        assert bool(shape.mask[y, x]) == bool(shape.mask.any())
        assert float(shape.smoothed[y, x]) == float(among.max())
        assert answer.point == best_pixel(shape.smoothed, shape.mask)
        assert answer.main_parts.equal(main_parts(shape.mask, answer.point, relevancy[shape.level]))
        assert answer.box == mask_box(answer.main_parts)
        assert answer.level == field.levels[shape.level]
        assert answer.heat.equal(relevancy[shape.level])
        assert (answer.z_score, answer.presence) == (None, True)
        assert not {"z_score", "present"} & set(answer.record())


@pytest.mark.parametrize("has_things", [False, True])
def test_what_is_absent_gets_neither_mask_nor_point(
    queried: Queried, voted: Queried, has_things: bool
) -> None:
    camera, texts = queried.camera, queried.texts
    field = queried.field if has_things else voted.field
    projection = field.project(camera)
    maps = field.relevancy(camera, texts.queries, texts.canonical, projection)
    shapes = [segment(each) for each in maps.unbind(1)]
    scores = view_z_scores(field, projection, shapes, texts.queries, texts.everyday).tolist()
    things: list[tuple[Tensor, int] | None] = [None] * len(shapes)
    if has_things:
        assert field.thing_table is not None
        seen = things_of_view(
            ThingFits.of(field.thing_table, texts), projection, [each.mask for each in shapes]
        )
        things = seen.masks
        scores = [one + other for one, other in zip(scores, seen.presence, strict=True)]
    middle = sorted(scores)[5]
    answers = answer_view(field, camera, replace(texts, present_from=middle), projection)
    assert sum(answer.presence for answer in answers) == 6
    for answer, shape, z_score, thing in zip(answers, shapes, scores, things, strict=True):
        assert answer.z_score == pytest.approx(z_score, abs=1e-4)
        assert answer.presence == (answer.z_score is not None and answer.z_score >= middle)
        if thing is None:
            assert answer.score == pytest.approx(shape.score, abs=1e-5)
        assert answer.threshold == (shape.threshold if thing is None else None)
        if not answer.presence:
            assert (answer.point, answer.box, answer.coverage) == (None, None, 0.0)
            assert not answer.mask.any()
        record = json.loads(json.dumps(answer.record(), allow_nan=False))
        assert record["present"] == answer.presence
        assert record["z_score"] == pytest.approx(z_score, abs=1e-3)
        expected = None if answer.threshold is None else pytest.approx(answer.threshold, abs=1e-3)
        assert record["threshold"] == expected


@pytest.mark.parametrize("threshold", [0.5, None])
def test_answers_of_a_scene(queried: Queried, threshold: float | None) -> None:
    field, texts = queried.field, queried.texts
    found = list(select_each(field, texts.queries, texts.canonical, threshold, 10))
    scores = scene_z_scores(field, found, texts.queries, texts.everyday).tolist()
    scores = [with_evidence(score, each.mask) for score, each in zip(scores, found, strict=True)]
    question = replace(texts, threshold=threshold, neighbours=10)
    answers = answer_scene(field, question)
    judged = answer_scene(field, replace(question, present_from=(bound := max(-9.0, sorted(scores)[5]))))
    assert sum(answer.presence for answer in judged) == sum(score >= bound for score in scores) > 1
    for each, z_score, answer, other in zip(found, scores, answers, judged, strict=True):
        assert answer.mask.equal(each.mask)
        assert (answer.level, answer.score) == (field.levels[each.level], each.score)
        assert answer.threshold == each.threshold
        assert threshold in (None, answer.threshold)
        assert (answer.z_score, other.z_score) == (None, z_score)
        assert other.mask.equal(each.mask & other.presence)
        record = json.loads(json.dumps(other.record(), allow_nan=False))
        assert record["gaussians"] == int(other.mask.sum())
        assert record["threshold"] == pytest.approx(each.threshold, abs=1e-3)
        assert record["present"] == other.presence


def test_records_hold_no_infinity() -> None:
    nothing = torch.zeros(2, 3, dtype=torch.bool)
    answer = Answer(nothing, nothing.float(), nothing, None, 0.0, "s", 0.5, None, -torch.inf, False)
    assert answer.record() == {
        "level": "s",
        "score": 0.5,
        "threshold": None,
        "pixel": None,
        "coverage": 0.0,
        "box": None,
        "z_score": None,
        "present": False,
    }
    record = SceneAnswer(nothing[0], nothing[0].float(), "s", -torch.inf).record()
    assert record == {"gaussians": 0, "level": "s", "score": None, "threshold": None}


def test_presence_needs_enough_words(queried: Queried) -> None:
    texts = queried.texts
    few = replace(texts, everyday=texts.everyday[: LEAST_WORDS - 1])
    assert len(answer_view(queried.field, queried.camera, few)) == len(texts.queries)
    with pytest.raises(InputError, match="everyday words or more"):
        answer_view(queried.field, queried.camera, replace(few, present_from=2))
    with pytest.raises(InputError, match="everyday words or more"):
        answer_scene(queried.field, replace(few, present_from=2))


def test_the_box_and_the_crop_follow_the_main_parts() -> None:
    mask = torch.zeros(20, 30, dtype=torch.bool)
    mask[5:9, 10:16] = mask[19, 0] = True
    parts = mask.clone()
    parts[19, 0] = False
    answer = Answer(mask, mask.float(), parts, (10, 5, 16, 9), 0.04, "s", 0.9, (12, 6))
    image = torch.arange(600).view(20, 30)
    assert answer.crop(image) is not None
    assert torch.equal(answer.crop(image), image[5:9, 10:16])  # pyright: ignore[reportArgumentType]
    assert answer.crop(image, margin=12).shape == (20, 28)  # pyright: ignore[reportOptionalMemberAccess]
    picture = Image.fromarray(np.zeros((20, 30, 3), np.uint8))
    assert answer.crop(picture).shape == (4, 6, 3)  # pyright: ignore[reportOptionalMemberAccess]
    assert replace(answer, box=None).crop(image) is None
    for wrong in (image[1:], image.T):
        with pytest.raises(InputError, match="cannot be cropped"):
            answer.crop(wrong)
    with pytest.raises(InputError, match="margin of -1"):
        answer.crop(image, -1)
