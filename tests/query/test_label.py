"""One word for each Gaussian, against a plain reading of the rule."""

from __future__ import annotations

from dataclasses import replace

import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from messages import refuses
from query.conftest import ASKED, Queried
from scoup.base import UnknownNameError
from scoup.query.answer import Answer
from scoup.query.answer_scene import each_answer
from scoup.query.labels import NONE, labels_of_answers
from support import examples

LEVELS = ("s", "m", "l")


@settings(max_examples=examples(100))
@given(
    st.lists(st.tuples(st.sampled_from(LEVELS), st.sampled_from([None, 0.0, 0.4, 0.9])), min_size=1, max_size=6),
    st.floats(0, 1),
    st.integers(0, 2**31),
)  # fmt: skip
def test_of_words_for_one_gaussian_the_finest_level_counts_then_the_score(
    words: list[tuple[str, float | None]], share: float, seed: int
) -> None:
    masks = torch.rand(len(words), 20, generator=torch.Generator().manual_seed(seed)) < share
    answers = [
        Answer(str(number), mask, level, score, ASKED)
        for number, ((level, score), mask) in enumerate(zip(words, masks, strict=True))
    ]
    found = labels_of_answers(answers, LEVELS)
    for row in range(20):
        fitting = [number for number in range(len(words)) if masks[number, row]]
        finest = [n for n in fitting if words[n][0] == min((words[k][0] for k in fitting), key=LEVELS.index)]
        best = max(finest, key=lambda n: words[n][1] or 0.0, default=NONE)  # the first of equals
        assert int(found[row]) == best


def test_labels_are_the_answers(queried: Queried, voted: Queried) -> None:
    for asked in (queried, voted):
        for question in (asked.texts, replace(asked.texts, threshold=0.3)):
            answers, found = list(each_answer(asked.field, question)), asked.field.label(question)
            assert [*zip(found.levels, found.scores, found.presence, found.things, strict=True)] == [
                (each.level, each.score, each.presence, each.things) for each in answers
            ]
            counts = found.counts()
            assert sum(counts.values()) == len(asked.field)
            for number, name in enumerate(found.names):
                mine = found.ids == number
                assert counts[name] == int(found.mask(name).sum()) == int(mine.sum())
                assert set(found.instances[mine].tolist()) <= set(found.things[number] or [NONE])
            assert found.mask("none").equal(found.ids == NONE)
    with refuses(UnknownNameError):
        found.mask("word one")


def test_words_for_absent_things_label_nothing(queried: Queried, voted: Queried) -> None:
    for asked in (queried, voted):
        field, texts = asked.field, asked.texts
        bound = sorted(answer.score or 0 for answer in list(each_answer(field, texts)))[6]
        judged = field.label(replace(texts, present_from=bound))
        present = [number for number, there in enumerate(judged.presence) if there]
        assert 0 < len(present) < len(judged.names)
        kept = replace(texts, texts=tuple(texts.texts[n] for n in present), queries=texts.queries[present])
        expected = torch.tensor([*present, NONE])[field.label(kept).ids.long()]
        assert judged.ids.equal(expected.int())
        assert not any(judged.things[n] for n in range(len(judged.names)) if n not in present)


def test_words_differ_from_each_other_and_from_none(queried: Queried) -> None:
    once = queried.texts.one(1)
    twice = replace(once, texts=once.texts * 2, queries=once.queries.expand(2, -1))
    with refuses():
        queried.field.label(replace(twice, texts=("word 1", "none")))
    found = queried.field.label(twice)
    assert found.names == ("word 1",)
    assert found.ids.equal(queried.field.label(once).ids)
