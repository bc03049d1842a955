"""The one rule: texts to answers of the scene."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from scoup.field import Field
from scoup.query.answer import Answer, RunnerUp
from scoup.query.matching import compare_things
from scoup.query.named import Named, choose, named_texts
from scoup.query.presence import TextScore, is_present, other_words
from scoup.query.question import Question
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
    answers = _by_things if question.threshold is None and field.thing_table is not None else _by_votes
    for answer in answers(field, question):
        if is_present(answer.score, int(answer.mask.sum()), question.present_from):
            yield answer
        else:
            nothing = torch.zeros_like(answer.mask)
            yield replace(answer, presence=False, mask=nothing, things=(), scores=())


def _by_things(field: Field, question: Question[Any]) -> Iterator[Answer]:
    known = compare_things(field, question)
    if known is None:
        yield from _by_votes(field, question)
        return
    fits = known.fits(question.queries)
    names = named_texts(field.thing_table, question)
    scores = text_scores(question, known.best_fits, names)
    for number, choice in enumerate(choose(known, fits, names, question.level)):
        text, score = question.texts[number], scores[number]
        if choice is None:
            nothing, level = torch.zeros(len(field), dtype=torch.bool), question.level or 0
            least = 0.0 if question.can_judge_presence else None
            yield Answer(text, nothing, field.levels[level], least, question.vectors_of(number, level))
            continue
        level, rival = int(known.things.levels[choice.things[0]]), choice.runner_up
        things = choice.things.tolist()
        yield Answer(
            text=text,
            mask=known.things.members(choice.things).cpu(),
            level=field.levels[level],
            score=score(choice.fit),
            asked=question.vectors_of(number, level),
            things=tuple(things),
            scores=tuple(score(float(fits[thing, number]), thing) for thing in things),
            runner_up=None if rival is None else RunnerUp(rival, score(float(fits[rival, number]), rival)),
        )


def _by_votes(field: Field, question: Question[Any]) -> Iterator[Answer]:
    scores: list[float | None] = [None] * len(question.texts)
    if question.can_judge_presence:
        votes = sampled_votes(field, question)
        fits, of_texts = votes.fits(question.queries).tolist(), text_scores(question, votes.best_fits)
        scores = [score(fit) for score, fit in zip(of_texts, fits, strict=True)]
    for number, (selection, score) in enumerate(zip(select_each(field, question), scores, strict=True)):
        asked = question.vectors_of(number, selection.level)
        mask, level = selection.mask.cpu(), field.levels[selection.level]
        yield Answer(question.texts[number], mask, level, score, asked, threshold=selection.threshold)


def text_scores(
    question: Question[Any], best_fits: Tensor, names: Sequence[Named | None] = ()
) -> list[TextScore]:
    """Return the score of each text against the best fits of everyday words [B], joined with that of its name; with
    too few words, none counts."""
    every = zip(compared_others(question), names or [None] * len(question.texts), strict=True)
    return [TextScore(best_fits[: len(own)], own, named) for own, named in every]


def compared_others(question: Question[Any]) -> Tensor:
    """Return which everyday words count for each text, [Q, B] boolean; [Q, 0] with too few words."""
    queries = question.queries.float().cpu()
    if not question.can_judge_presence:
        return torch.zeros(len(queries), 0, dtype=torch.bool)
    return other_words(queries, question.everyday.float().cpu())


def sampled_votes(field: Field, question: Question[Any]) -> SampledVotes:
    """Return the votes of some Gaussians of a field for everyday words, from its cache."""
    words = (each.cpu().numpy().tobytes() for each in (question.everyday, question.canonical))
    return field.kept((SampledVotes, *words), lambda: SampledVotes(field, question))
