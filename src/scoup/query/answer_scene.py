"""The one rule: texts to answers of the scene."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import torch

from scoup.field import Field
from scoup.query.answer import Answer
from scoup.query.named import named_texts
from scoup.query.presence import is_present, text_scores
from scoup.query.question import Question
from scoup.query.thing_index import ThingIndex, thing_index
from scoup.query.votes import SampledVotes, select_each


def answer_scene(field: Field, question: Question[Any]) -> list[Answer]:
    """Answer each text in the scene; every way to ask (``scoup.query.ask``) calls this.

    Things answer where the field has them. The votes of the Gaussians answer in other fields, and where the question
    has a threshold for them.

    Raises:
        InputError: the vectors do not fit the field, or the threshold is not 0 to 1.
    """
    return list(each_answer(field, question))


def each_answer(field: Field, question: Question[Any]) -> Iterator[Answer]:
    """Yield the answers of ``answer_scene`` one by one, for many texts about many Gaussians."""
    index = None if question.threshold is not None else thing_index(field, question)
    yield from _by_votes(field, question) if index is None else _by_things(field, index, question)


def _by_things(field: Field, index: ThingIndex, question: Question[Any]) -> Iterator[Answer]:
    table = field.thing_table
    assert table is not None
    verdicts = index.judge(question, index.fits(question.queries), named_texts(table, question))
    for number, (verdict,) in enumerate(verdicts):
        things = verdict.things if verdict.presence else ()
        yield Answer(
            text=question.texts[number],
            mask=table.members(torch.tensor(things, dtype=torch.int64)).cpu(),
            level=field.levels[verdict.level],
            score=verdict.score,
            asked=question.vectors_of(number, verdict.level),
            presence=verdict.presence,
            things=things,
            scores=verdict.scores if verdict.presence else (),
            runner_up=verdict.runner_up,
        )


def _by_votes(field: Field, question: Question[Any]) -> Iterator[Answer]:
    scores: list[float | None] = [None] * len(question.texts)
    if question.can_judge_presence:
        votes = sampled_votes(field, question)
        fits, of_texts = votes.fits(question.queries).tolist(), text_scores(question, votes.best_fits[None])
        scores = [score(fit) for score, fit in zip(of_texts, fits, strict=True)]
    for number, (selection, score) in enumerate(zip(select_each(field, question), scores, strict=True)):
        text, level, mask = question.texts[number], field.levels[selection.level], selection.mask.cpu()
        presence = is_present(score, int(mask.sum()), question.present_from)
        asked = question.vectors_of(number, selection.level)
        mask = mask if presence else torch.zeros_like(mask)
        yield Answer(text, mask, level, score, asked, presence, threshold=selection.threshold)


def sampled_votes(field: Field, question: Question[Any]) -> SampledVotes:
    """Return the votes of some Gaussians of a field for everyday words, from its cache."""
    words = (each.cpu().numpy().tobytes() for each in (question.everyday, question.canonical))
    return field.kept((SampledVotes, *words), lambda: SampledVotes(field, question))
