"""One word for each Gaussian, against a plain reading of the rule."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch

from query.conftest import Queried
from scoup.base.errors import InputError, UnknownNameError
from scoup.query.answering import answer_scene, judged_selections
from scoup.query.label import NONE, label
from scoup.query.presence import scene_z_scores, with_evidence
from scoup.query.select import select_each
from scoup.query.things import ThingFits


@pytest.mark.parametrize("threshold", [0.3, None])
def test_labels_are_the_best_words_of_those_that_select(voted: Queried, threshold: float | None) -> None:
    field, texts = voted.field, voted.texts
    found = label(field, replace(texts, threshold=threshold))
    selections = list(select_each(field, texts.queries, texts.canonical, threshold))
    for row in range(len(field)):
        fitting = [number for number, each in enumerate(selections) if each.mask[row]]
        values = [float(selections[number].relevancy[row]) for number in fitting]
        finest = min((selections[number].level for number in fitting), default=0)
        values = [
            value if selections[n].level == finest else -1.0 for n, value in zip(fitting, values, strict=True)
        ]
        assert int(found.ids[row]) == (fitting[values.index(max(values))] if fitting else NONE)
        assert float(found.scores[row]) == (max(values) if fitting else -torch.inf)
    assert found.levels == tuple(field.levels[each.level] for each in selections)
    assert len({each.level for each in selections}) > 1
    assert found.z_scores is None
    counts = found.counts()
    assert sum(counts.values()) == len(field)
    for number, name in enumerate(found.names):
        assert counts[name] == int(found.mask(name).sum()) == int((found.ids == number).sum())
    assert found.mask("none").equal(found.ids == NONE)
    assert 0 < counts["none"] < len(field)
    with pytest.raises(UnknownNameError, match="word 1"):
        found.mask("word one")


@pytest.mark.parametrize("has_things", [False, True])
def test_words_for_absent_things_label_nothing(queried: Queried, voted: Queried, has_things: bool) -> None:
    field, texts = (queried if has_things else voted).field, queried.texts
    everything = label(field, texts)
    found = list(select_each(field, texts.queries, texts.canonical))
    scores = scene_z_scores(field, found, texts.queries, texts.everyday).tolist()
    if has_things:
        assert field.thing_table is not None
        fits = ThingFits.of(field.thing_table, texts)
        scores = [score + fits.presence(number) for number, score in enumerate(scores)]
    selected = [found.mask for found, _ in judged_selections(field, texts)]
    scores = [with_evidence(*each) for each in zip(scores, selected, strict=True)]
    middle = min(score for score in scores if score > -math.inf)
    judged = label(field, replace(texts, present_from=middle))
    assert judged.z_scores is not None
    assert judged.z_scores == pytest.approx(scores)
    assert judged.presence == tuple(score >= middle for score in scores)
    present = [number for number, there in enumerate(judged.presence) if there]
    alone = label(
        field, replace(texts, texts=tuple(texts.texts[n] for n in present), queries=texts.queries[present])
    )
    expected = torch.tensor([*present, NONE])[alone.ids.long()]
    assert judged.ids.equal(expected.int())
    assert not judged.ids.equal(everything.ids)


def test_words_name_the_things_that_answer_them(queried: Queried, voted: Queried) -> None:
    field, texts = queried.field, queried.texts
    found = label(field, texts)
    assert found.things == tuple(field.location(answer).things for answer in answer_scene(field, texts))
    assert any(found.things)
    table = field.thing_table
    assert table is not None
    for name, level, things in zip(found.names, found.levels, found.things, strict=True):
        assert {field.levels[int(table.levels[thing])] for thing in things} <= {level}, name
    assert not any(label(voted.field, texts).things)
    assert not any(label(field, replace(texts, threshold=0.3)).things)
    judged = label(field, replace(texts, present_from=1e3))
    assert not any(judged.presence)
    assert not any(judged.things)


@pytest.mark.parametrize("words", [("word 1", "word 1"), ("word 1", "none")])
def test_words_that_cannot_be_distinguished_are_refused(queried: Queried, words: tuple[str, str]) -> None:
    texts = replace(queried.texts, texts=words, queries=queried.texts.queries[:2])
    with pytest.raises(InputError, match="words that differ"):
        label(queried.field, texts)
