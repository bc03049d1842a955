"""The rule from texts to the answers of a scene."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import torch

from scoup.field import Field
from scoup.query.answer import Answer
from scoup.query.named import named_texts
from scoup.query.presence import is_present, text_scores
from scoup.query.question import Question
from scoup.query.thing_judge import thing_index
from scoup.query.votes import SampledVotes, select_each


def each_answer(field: Field, question: Question[Any]) -> Iterator[Answer]:
    """Yield the answer of the scene to each text; every way to ask (``scoup.query.ask``) calls this.

    Things answer where the field has them. The votes of the Gaussians answer in other fields, and where the question
    has a threshold for them.

    Raises:
        InputError: the vectors do not fit the field, or the threshold is not 0 to 1.
    """
    table, index = field.thing_table, thing_index(field, question) if question.threshold is None else None
    if table is None or index is None:
        yield from _by_votes(field, question)
        return
    for number, (verdict,) in enumerate(index.judge(question, named_texts(table, question))):
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
    words = (vectors.cpu().numpy().tobytes() for vectors in (question.everyday, question.canonical))
    return field.kept((SampledVotes, *words), lambda: SampledVotes(field, question))
