"""Answers of a scene for the page: what the shader needs to light up the Gaussians of a text."""

from __future__ import annotations

import base64
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

from torch import Tensor

from scoup.base import InputError
from scoup.field import Field
from scoup.query import ExpressionAnswer, Question, answers_of, level_thresholds
from scoup.view.scene_data import atom_scores

_AT_A_TIME = 16  # texts whose Gaussians are in memory together
VERDICT = ("score", "certainty", "present", "gaussians", "runner_up")
"""What the page shows of ``Answer.to_dict``."""


@dataclass(frozen=True, eq=False)
class PageAnswer:
    """The answer of a scene to one text, as the page takes it: that of ``field.answer``, and what the page needs to
    show relevancy, and to select by a threshold of choice.
    """

    text: str
    verdict: dict[str, Any]  # of ``Answer.to_dict``: ``VERDICT``
    remark: str  # of ``Answer.remark``
    is_text: bool  # a text alone, whose remark the page does not show
    level: int  # position of the level that answers
    # If presence is not judged: the page shows absent texts on demand, and a level of choice for what is present.
    chosen_things: list[int] | None  # that answer if no level is chosen; None in a field without things
    things: list[list[int] | None]  # per level, that answer if it is chosen; None in a field without things
    without: list[int]  # things whose Gaussians do not answer
    scores: Tensor  # [S, L] float32, inner products of atoms and text
    thresholds: Tensor  # [S] stable threshold of each level, on the rescaled relevancy
    spans: Tensor  # [S, 2] relevancies that rescaling takes to 0 and 1 at each level

    def to_dict(self) -> dict[str, Any]:
        """Return plain JSON values; ``scores`` as base64 of float32, little-endian."""
        return {
            "text": self.text,
            **self.verdict,
            "remark": None if self.is_text else self.remark,
            "level": self.level,
            "thresholds": [round(value, 4) for value in self.thresholds.tolist()],
            "spans": [[round(low, 6), round(high, 6)] for low, high in self.spans.tolist()],
            "chosen_things": self.chosen_things,
            "things": self.things,
            "without": self.without,
            "scores": base64.b64encode(self.scores.contiguous().numpy().astype("<f4").tobytes()).decode(),
        }


def scene_answers(field: Field, question: Question) -> Iterator[PageAnswer]:
    """Yield the answer to each text or phrase, in their order."""
    starts = range(0, len(question.texts), _AT_A_TIME)
    batches = (question.some(slice(start, start + _AT_A_TIME)) for start in starts)
    for some in [question] if question.asked else batches:
        yield from _some_answers(field, some)


def _some_answers(field: Field, question: Question) -> Iterator[PageAnswer]:
    coded, answers = field.coded_levels().cpu(), answers_of(field, question)
    by_things = answers[0].threshold is None
    if by_things:  # the page draws things, so an expression is present if it has any
        answers = [
            replace(one, presence=bool(one.things)) if isinstance(one, ExpressionAnswer) else one
            for one in answers
        ]
    if question.asked and not by_things:
        raise InputError(
            f"{question.asked[0][0]}: this field has no things, so pages answer single texts only"
        )
    of_levels = [
        answers_of(field, replace(question, present_from=None, level=level), keep=False)
        if by_things
        else answers
        for level in (None, *range(len(field.levels)))
    ]
    for answer, of_any, *others in zip(answers, *of_levels, strict=True):
        asked, record = answer.asked, answer.to_dict()
        relevancy = field.gaussian_relevancy(asked.query, asked.canonical)[:, 0].cpu()
        chosen = answer if answer.presence else of_any
        yield PageAnswer(
            answer.text,
            {key: record[key] for key in VERDICT},
            answer.remark(),
            not isinstance(answer, ExpressionAnswer),
            asked.level,
            list(chosen.things) if by_things else None,
            [list(other.things) if by_things else None for other in others],
            list(chosen.without) if isinstance(chosen, ExpressionAnswer) else [],
            atom_scores(field, asked.query)[:, :, 0].contiguous(),
            *level_thresholds(relevancy, coded),
        )
