"""Answers for the page and for agents are those of the scene."""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import torch
from view_samples import (
    DIM,
    WORDS,
    field_with_things,
    of_select,
    random_field,
    selected_by_votes,
    table,
    unpacked,
    viewed_field,
)

from messages import refuses
from scoup.base import UnknownNameError
from scoup.field import NO_THING, ThingTable
from scoup.field.thing_table import TENSORS
from scoup.io.word_list import read_words
from scoup.models import TextEncoder
from scoup.query import Answer, LanguageField, level_thresholds
from scoup.view.scene_answers import VERDICT, PageAnswer, scene_answers
from scoup.view.scene_data import NO_OWNER
from scoup.view.scene_tools import SceneTools
from scoup.view.viewed_field import ViewedField
from scoup.view.vocabulary import words_data
from support import altered


@pytest.fixture(scope="module")
def viewed() -> ViewedField:
    return viewed_field(count=300)


@pytest.fixture(scope="module")
def of_things() -> ViewedField:
    """A field with things, which contains some words and not others."""
    return ViewedField(field_with_things().with_encoder(table()))


def verdict(answer: Answer | PageAnswer) -> dict[str, object]:
    """What is said of an answer."""
    record = answer.to_dict()
    return {name: record[name] for name in VERDICT}


def test_levels_thresholds_and_gaussians_are_those_of_select(viewed: ViewedField) -> None:
    for answer in viewed.answers(WORDS[:6]):
        for level in (None, 0, 1):
            wanted, own = of_select(viewed, answer.text, level), answer.level if level is None else level
            assert wanted.level == viewed.field.levels[own]
            assert wanted.threshold == pytest.approx(float(answer.thresholds[own]))
            shown = selected_by_votes(viewed, answer.text, level)
            assert int((shown != wanted.mask).sum()) <= 1  # one on the threshold, by rounding
            saved, rest = (
                viewed.selection([answer.text], level, rest=rest, always=True) for rest in (False, True)
            )
            assert (len(saved), len(rest)) == (int(wanted.mask.sum()), int((~wanted.mask).sum()))
    # A threshold alone leaves the level that answers.
    fixed = viewed.selection(["thing 2"], None, 0.3, always=True)
    assert abs(len(fixed) - int(selected_by_votes(viewed, "thing 2", None, 0.3).sum())) <= 1
    with refuses():
        viewed.selection(["thing 2"], None, 1.0, always=True)


def test_things_of_each_level_are_those_of_select(of_things: ViewedField) -> None:
    things = of_things.field.thing_table
    assert things is not None
    for answer in of_things.answers(WORDS[::2]):
        for level, chosen in [(None, answer.chosen_things), *enumerate(answer.things)]:
            wanted = of_select(of_things, answer.text, level)
            assert chosen == list(wanted.things)
            assert torch.equal(torch.isin(things.owners, torch.tensor(chosen)).any(1), wanted.mask)
    saved = of_things.selection(["thing 1"], 0, always=True)
    assert len(saved) == int(of_select(of_things, "thing 1", 0).mask.sum())
    # An expression is present where the page has things to draw.
    for text, numbers in (("thing 7 and thing 1", []), ("thing 7 and not thing 1", [7])):
        answer = of_things.answers([text])[0]
        assert (answer.verdict["present"], answer.chosen_things) == (bool(numbers), numbers)


@pytest.mark.parametrize("make", [field_with_things, lambda: random_field(300)], ids=["things", "votes"])
def test_page_exported_page_and_agents_do_not_contradict_the_field(make: Callable[[], LanguageField]) -> None:
    field = make().with_encoder(table())
    tools, answers, page = (
        SceneTools({"f": field}),
        field.answer(list(WORDS)),
        ViewedField(field).answers(WORDS),
    )
    for answer, on_page, exported in zip(answers, page, exported_verdicts(field, page), strict=True):
        assert verdict(answer) == verdict(on_page)
        wanted = {name: verdict(answer)[name] for name in exported}
        assert exported == wanted | {"score": pytest.approx(wanted["score"])}
        assert field.levels[on_page.level] == answer.level
        assert (on_page.chosen_things or [] if answer.presence else []) == list(answer.things)
        reply, things = tools.find("f", answer.text), field.things(answer.text)
        said = {name: answer.to_dict()[name] for name in ("score", "certainty", "count", "runner_up")}
        assert reply["texts"] == [{"text": answer.text, **said}]
        assert len(reply["things"]) == len(things)
        if answer.things:
            numbers = [each["thing"] for each in reply["things"]]
            assert numbers == [each.number for each in things] == list(answer.things)
            assert reply["things"][0]["level"] == answer.level
    assert {"sure", "not here"} <= {answer.certainty for answer in answers}


def exported_verdicts(field: LanguageField, answers: list[PageAnswer]) -> Iterator[dict[str, object]]:
    """What an exported page says of each answer, but for the runner-up."""
    question = field.question([answer.text for answer in answers])
    tensors, metadata = unpacked(words_data(field, question, answers))
    for row in range(len(answers)):
        yield {
            "score": float(tensors["score"][row]),
            "certainty": metadata["certainties"][tensors["certainty"][row]],
            "present": bool(tensors["present"][row]),
            "gaussians": int(tensors["gaussians"][row]),
        }


def test_without_things_the_votes_answer_at_every_level(viewed: ViewedField) -> None:
    field = field_with_things()
    assert field.thing_table is not None
    none = {name: getattr(field.thing_table, name)[:0] for name in TENSORS[1:]}
    nothing = ThingTable(torch.full_like(field.thing_table.owners, NO_THING), **none)
    for each in (viewed, ViewedField(altered(field, thing_table=nothing, words=table()))):
        answer = each.answers(["thing 1"])[0]
        assert (answer.chosen_things, answer.things) == (None, [None, None])
        assert answer.to_dict()["things"] == [None, None]
        tensors = unpacked(words_data(each.field, each.question(["thing 1"]), [answer]))[0]
        assert not {"things", "runner_up"} & set(tensors)


def test_the_record_is_json_with_the_scores_bit_for_bit(viewed: ViewedField) -> None:
    answer = viewed.answers(["thing 1"])[0]
    record = json.loads(json.dumps(answer.to_dict()))
    scores = np.frombuffer(base64.b64decode(record["scores"]), "<f4").reshape(2, 9)
    assert np.array_equal(scores, answer.scores.numpy())
    assert record["text"] == "thing 1"
    assert len(record["thresholds"]) == len(record["spans"]) == 2
    # Nothing is infinite where no Gaussian has a code.
    empty = viewed_field(count=5)
    empty.field.code_weights[:] = 0
    record = empty.answers(["thing 1"])[0].to_dict()
    assert (record["certainty"], record["present"], record["gaussians"]) == ("not here", False, 0)
    json.dumps(record, allow_nan=False)
    spans = level_thresholds(torch.zeros(2, 0), torch.zeros(2, 0, dtype=torch.bool))[1]
    assert spans.tolist() == [[0.5, 0.5]] * 2


def test_the_vocabulary_is_the_table_or_a_list(viewed: ViewedField, tmp_path: Path) -> None:
    own = viewed_field(words=["thing 4", "thing 2"])
    for each, wanted in ((viewed, WORDS), (own, ("thing 4", "thing 2"))):
        vocabulary = each.vocabulary()
        assert vocabulary is not None
        assert vocabulary.texts == wanted  # of the table, without its phrases
    assert viewed.is_closed()
    with pytest.raises(UnknownNameError):
        viewed_field(words=["nothing"]).vocabulary()
    assert "kettle" in TextEncoder("a/model", 4, None).vocabulary()
    listed = tmp_path / "list.txt"
    listed.write_text(" a  b\n\nc\na b\n")
    assert read_words(listed) == ("a b", "c")
    listed.write_text(" \n")
    with refuses():
        read_words(listed)


def test_words_hold_the_same_answers(viewed: ViewedField, of_things: ViewedField) -> None:
    question = viewed.question(WORDS)
    answers = list(scene_answers(viewed.field, question))
    tensors, metadata = unpacked(words_data(viewed.field, question, answers))
    assert metadata["names"] == list(WORDS)
    assert tensors["scores"].shape == (len(WORDS), 2, 9)
    assert tensors["scores"].dtype == np.float16
    one, row = viewed.answers(["thing 7"])[0], WORDS.index("thing 7")
    assert np.abs(tensors["scores"][row] - one.scores.numpy()).max() < 1e-3
    assert tensors["levels"][row] == one.level
    codebook = viewed.field.codebook.numpy()
    np.testing.assert_allclose(tensors["gram"], codebook @ codebook.transpose(0, 2, 1), atol=1e-3)
    verdicts = list(exported_verdicts(viewed.field, answers))
    assert list(exported_verdicts(viewed.field, [one])) == verdicts[row : row + 1]
    np.testing.assert_allclose(tensors["thresholds"][row], one.thresholds.numpy())
    np.testing.assert_allclose(tensors["spans"][row], one.spans.numpy(), atol=1e-6)
    few = {name: vector for name, vector in table().items() if name not in WORDS[3:]}
    unjudged = ViewedField(random_field().with_encoder(few))
    assert unjudged.metadata()["present_from"] is None
    question = unjudged.question(["thing 0"])
    stored = unpacked(words_data(unjudged.field, question, unjudged.answers(["thing 0"])))[0]
    assert math.isnan(stored["score"][0])
    assert (stored["certainty"][0], stored["present"][0]) == (255, 1)
    # And name the same things.
    answers = of_things.answers(WORDS)
    tensors = unpacked(words_data(of_things.field, of_things.question(WORDS), answers))[0]
    assert tensors["thing_counts"].shape == (len(WORDS), 4)
    # Things of no other thing are their own best parts.
    named = [[answer.chosen_things, *answer.things, answer.chosen_things] for answer in answers]
    assert [[len(each or ()) for each in row] for row in named] == tensors["thing_counts"].tolist()
    assert [number for row in named for each in row for number in each or ()] == tensors["things"].tolist()
    rivals = [answer.verdict["runner_up"] or {"thing": NO_OWNER, "score": math.nan} for answer in answers]
    assert [rival["thing"] for rival in rivals] == tensors["runner_up"].tolist()
    scores = pytest.approx(tensors["runner_up_score"].tolist(), nan_ok=True)
    assert [rival["score"] for rival in rivals] == scores


def test_an_encoder_of_another_size_is_refused_only_if_it_was_given() -> None:
    with refuses():
        ViewedField(random_field().with_encoder(table(DIM + 1)))
    with refuses():
        ViewedField(random_field().with_encoder(table()), most=0)
