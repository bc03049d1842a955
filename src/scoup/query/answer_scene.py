"""The one rule: texts to answers of the scene."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from scoup.field.language_field import LanguageField
from scoup.query.answer import Answer, AskedText, RunnerUp
from scoup.query.matching import compare_things
from scoup.query.named import choose, instances_of, named_texts
from scoup.query.presence import NullScores, is_present, other_words
from scoup.query.question import Question
from scoup.query.votes import SampledVotes, select_each


def answer_scene(field: LanguageField, question: Question[Any]) -> list[Answer]:
    """Answer each text in the scene; every way to ask (``scoup.query.ask``) calls this.

    Things answer where the field has them. The votes of the Gaussians answer in other fields, and where the question
    has a threshold for them.

    Raises:
        InputError: the vectors do not fit the field, or the threshold is not 0 to 1.
    """
    return list(each_answer(field, question))


def each_answer(field: LanguageField, question: Question[Any]) -> Iterator[Answer]:
    """Yield the answers of ``answer_scene`` one by one, for many texts about many Gaussians."""
    answers = _by_things if question.threshold is None and field.thing_table is not None else _by_votes
    for number, answer in enumerate(answers(field, question)):
        presence = is_present(answer.score, int(answer.mask.sum()), question.present_from)
        asked = (AskedText(question.one(number), field.level_index(answer.level)),)
        answer = replace(answer, presence=presence, asked=asked, field=field)
        if not presence:
            answer = replace(answer, mask=torch.zeros_like(answer.mask), things=(), instances=())
        yield answer


def _by_things(field: LanguageField, question: Question[Any]) -> Iterator[Answer]:
    known = compare_things(field, question)
    if known is None:
        yield from _by_votes(field, question)
        return
    fits = known.fits(question.queries)
    scores, names = null_scores(question, known.best_fits), named_texts(field.thing_table, question)
    for number, choice in enumerate(choose(known, fits, names, question.level)):
        text, score, named = question.texts[number], scores[number], names[number]
        if choice is None:
            nothing, level = torch.zeros(len(field), dtype=torch.bool), field.levels[question.level or 0]
            yield Answer(text, nothing, level, 0.0 if question.can_judge_presence else None)
            continue
        level = int(known.things.levels[choice.things[0]])
        rival, sure = choice.runner_up, score(choice.fit)
        of_rival = None if rival is None else score(float(fits[rival, number]))
        instances = instances_of(known, fits[:, number], choice, named)
        yield Answer(
            text=text,
            mask=known.things.members(choice.things).cpu(),
            level=field.levels[level],
            score=sure if named is None else named.score(sure),
            things=tuple(choice.things.tolist()),
            instances=tuple(instances.tolist()),
            runner_up=None
            if rival is None
            else RunnerUp(rival, of_rival if named is None else named.score(of_rival, rival)),
        )


def _by_votes(field: LanguageField, question: Question[Any]) -> Iterator[Answer]:
    scores: list[float | None] = [None] * len(question.texts)
    if question.can_judge_presence:
        votes = sampled_votes(field, question)
        null = null_scores(question, votes.best_fits)
        scores = [score(fit) for score, fit in zip(null, votes.fits(question.queries).tolist(), strict=True)]
    for number, (selection, score) in enumerate(zip(select_each(field, question), scores, strict=True)):
        text, level = question.texts[number], field.levels[selection.level]
        yield Answer(text, selection.mask.cpu(), level, score, threshold=selection.threshold)


def null_scores(question: Question[Any], best_fits: Tensor) -> list[NullScores]:
    """Return the scores of each text against the best fits of everyday words [B]; none with too few words."""
    queries, words = question.queries.float().cpu(), question.everyday.float().cpu()
    if not question.can_judge_presence:
        return [NullScores(best_fits[:0], torch.zeros(0, dtype=torch.bool))] * len(queries)
    return [NullScores(best_fits, others) for others in other_words(queries, words)]


def sampled_votes(field: LanguageField, question: Question[Any]) -> SampledVotes:
    """Return the votes of some Gaussians of a field for everyday words, from its cache."""
    words = (each.cpu().numpy().tobytes() for each in (question.everyday, question.canonical))
    return field.kept((SampledVotes, *words), lambda: SampledVotes(field, question))
