"""Answers of a scene for the page: what the shader needs to light up the Gaussians of a text."""

from __future__ import annotations

import base64
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from scoup.query.answering import answer_scene
from scoup.query.coded_scene import CodedScene
from scoup.query.question import Question
from scoup.query.select import level_thresholds
from scoup.view.unit_codes import atom_scores

AT_A_TIME = 16  # texts whose Gaussians are in memory together
VERDICT = ("score", "certainty", "present", "gaussians", "runner_up")
"""What the page shows of ``Answer.record``."""


@dataclass(frozen=True, eq=False)
class PageAnswer:
    """The answer of a scene to one text, as the page takes it: that of ``field.answer``, and what the page needs to
    show relevancy, and to select by a threshold of choice.
    """

    text: str
    verdict: dict[str, Any]  # of ``Answer.record``: ``VERDICT``
    level: int  # position of the level that answers
    # If presence is not judged: the page shows absent texts on demand, and a level of choice for what is present.
    chosen_things: list[int] | None  # that answer if no level is chosen; None in a field without things
    things: list[list[int] | None]  # per level, that answer if it is chosen; None in a field without things
    scores: Tensor  # [S, L] float32, inner products of atoms and text
    thresholds: Tensor  # [S] stable threshold of each level, on the rescaled relevancy
    spans: Tensor  # [S, 2] relevancies that rescaling takes to 0 and 1 at each level

    def record(self) -> dict[str, Any]:
        """Return plain JSON values; ``scores`` as base64 of float32, little-endian."""
        return {
            "text": self.text,
            **self.verdict,
            "level": self.level,
            "thresholds": [round(value, 4) for value in self.thresholds.tolist()],
            "spans": [[round(low, 6), round(high, 6)] for low, high in self.spans.tolist()],
            "chosen_things": self.chosen_things,
            "things": self.things,
            "scores": base64.b64encode(self.scores.contiguous().numpy().astype("<f4").tobytes()).decode(),
        }


def scene_answers(field: CodedScene, question: Question) -> Iterator[PageAnswer]:
    """Yield the answer to each text, in their order.

    Args:
        field: to be queried.
        question: from ``field.question``.
    """
    for start in range(0, len(question.texts), AT_A_TIME):
        yield from _some_answers(field, question.some(slice(start, start + AT_A_TIME)))


def _some_answers(field: CodedScene, question: Question) -> Iterator[PageAnswer]:
    coded, scores = field.coded_levels().cpu(), atom_scores(field, question.queries)
    answers, levels = answer_scene(field, question), (None, *range(len(field.levels)))
    things: list[list[list[int] | None]] = [[None] * len(answers)] * len(levels)
    if answers[0].threshold is None:
        anyway = replace(question, present_from=None)
        things = [
            [list(answer.things) for answer in answer_scene(field, replace(anyway, level=level))]
            for level in levels
        ]
    for number, answer in enumerate(answers):
        one, record = question.one(number), answer.record()
        relevancy = field.gaussian_relevancy(one.queries, one.canonical)[:, 0].cpu()
        chosen, *of_levels = [found[number] for found in things]
        yield PageAnswer(
            answer.text,
            {key: record[key] for key in VERDICT},
            answer.asked[0].level,
            chosen,
            of_levels,
            scores[:, :, number].contiguous(),
            level_thresholds(relevancy, coded),
            spans(relevancy, coded),
        )


def spans(relevancy: Tensor, coded: Tensor) -> Tensor:
    """Return [S, 2]: the relevancies that ``scoup.query.selection.rescale`` takes to 0 and to 1 at each level.

    Args:
        relevancy: [S, N].
        coded: [S, N] boolean, those that count; a level without any has the span 0.5 to 0.5.
    """
    low = torch.where(coded, relevancy, torch.inf).amin(1) if relevancy.shape[1] else torch.zeros(len(coded))
    high = (
        torch.where(coded, relevancy, -torch.inf).amax(1) if relevancy.shape[1] else torch.zeros(len(coded))
    )
    ends = torch.stack([(low + high) / 2, high], 1)  # the lower half is cut off
    return torch.where(coded.any(1)[:, None], ends, 0.5)
