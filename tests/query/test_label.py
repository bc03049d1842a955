"""One word for each Gaussian, against a plain reading of the rule."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from query.conftest import Queried
from scoup.base.errors import InputError, UnknownNameError
from scoup.query.label import NONE, label
from scoup.query.presence import scene_z_scores
from scoup.query.select import select_each


def test_labels_are_the_best_words_by_their_own_levels(queried: Queried) -> None:
    field, texts = queried.field, queried.texts
    found = label(field, texts)
    maps = field.gaussian_relevancy(texts.queries, texts.canonical)
    levels = [each.level for each in select_each(field, texts.queries, texts.canonical)]
    for row in range(len(field)):
        best, word = 0.5, NONE
        for number, level in enumerate(levels):
            value = float(maps[level, number, row])
            if bool((field.code_weights[row, level] > 0).any()) and value > best:
                best, word = value, number
        assert int(found.ids[row]) == word
        if word != NONE:
            assert float(found.scores[row]) == pytest.approx(best)
    assert found.z_scores is None
    counts = found.counts()
    assert sum(counts.values()) == len(field)
    for number, name in enumerate(found.names):
        assert counts[name] == int(found.mask(name).sum()) == int((found.ids == number).sum())
    assert found.mask("none").equal(found.ids == NONE)
    assert 0 < counts["none"] < len(field)
    with pytest.raises(UnknownNameError, match="word 1"):
        found.mask("word one")


def test_words_for_absent_things_label_nothing(queried: Queried) -> None:
    field, texts = queried.field, queried.texts
    everything = label(field, texts)
    found = list(select_each(field, texts.queries, texts.canonical))
    scores = scene_z_scores(field, found, texts.queries, texts.everyday).tolist()
    middle = sorted(scores)[5]
    judged = label(field, texts, present_from=middle)
    assert judged.z_scores is not None
    assert judged.z_scores == pytest.approx(scores)
    assert judged.presence == tuple(score >= middle for score in scores)
    absent = torch.tensor([not there for there in judged.presence] + [False])[everything.ids.long()]
    assert absent.any()
    assert judged.ids.equal(torch.where(absent, NONE, everything.ids))


@pytest.mark.parametrize("words", [("word 1", "word 1"), ("word 1", "none")])
def test_words_that_cannot_be_distinguished_are_refused(queried: Queried, words: tuple[str, str]) -> None:
    texts = replace(queried.texts, texts=words, queries=queried.texts.queries[:2])
    with pytest.raises(InputError, match="words that differ"):
        label(queried.field, texts)
