"""Answers of a scene for the page: what the shader needs to light up the Gaussians of a text."""

from __future__ import annotations

import base64
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from scoup.field.language_field import LanguageField
from scoup.query.answer_scene import answers_of
from scoup.query.matching import compare_things
from scoup.query.named import choose, named_texts
from scoup.query.question import Question
from scoup.query.votes import level_thresholds
from scoup.view.unit_codes import atom_scores

AT_A_TIME = 16  # texts whose Gaussians are in memory together
VERDICT = ("score", "certainty", "present", "gaussians", "runner_up")
"""What the page shows of ``Answer.to_dict``."""


@dataclass(frozen=True, eq=False)
class PageAnswer:
    """The answer of a scene to one text, as the page takes it: that of ``field.answer``, and what the page needs to
    show relevancy, and to select by a threshold of choice.
    """

    text: str
    verdict: dict[str, Any]  # of ``Answer.to_dict``: ``VERDICT``
    level: int  # position of the level that answers
    # If presence is not judged: the page shows absent texts on demand, and a level of choice for what is present.
    chosen_things: list[int] | None  # that answer if no level is chosen; None in a field without things
    things: list[list[int] | None]  # per level, that answer if it is chosen; None in a field without things
    scores: Tensor  # [S, L] float32, inner products of atoms and text
    thresholds: Tensor  # [S] stable threshold of each level, on the rescaled relevancy
    spans: Tensor  # [S, 2] relevancies that rescaling takes to 0 and 1 at each level

    def to_dict(self) -> dict[str, Any]:
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


def scene_answers(field: LanguageField, question: Question) -> Iterator[PageAnswer]:
    """Yield the answer to each text, in their order.

    Args:
        field: to be queried.
        question: from ``field.question``.
    """
    for start in range(0, len(question.texts), AT_A_TIME):
        yield from _some_answers(field, question.some(slice(start, start + AT_A_TIME)))


def _some_answers(field: LanguageField, question: Question) -> Iterator[PageAnswer]:
    coded, scores = field.coded_levels().cpu(), atom_scores(field, question.queries)
    answers = answers_of(field, question)
    things = _things_of_levels(field, question) if answers[0].threshold is None else None
    for number, answer in enumerate(answers):
        one, record = question.one(number), answer.to_dict()
        relevancy = field.gaussian_relevancy(one.queries, one.canonical)[:, 0].cpu()
        chosen, *of_levels = [None] * (1 + len(field.levels)) if things is None else things[number]
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


def _things_of_levels(field: LanguageField, question: Question) -> list[list[list[int] | None]]:
    """Return what answers each text without a level of choice, and at each level, whether it is present or not."""
    known = compare_things(field, question)
    assert known is not None
    fits = known.fits(question.queries.float().cpu())
    named = named_texts(field.thing_table, question)
    chosen = [choose(known, fits, named, level) for level in (None, *range(len(field.levels)))]
    return [
        [[] if choice is None else choice.things.tolist() for choice in of_text]
        for of_text in zip(*chosen, strict=True)
    ]


def spans(relevancy: Tensor, coded: Tensor) -> Tensor:
    """Return [S, 2]: the relevancies that ``scoup.query.votes.rescale`` takes to 0 and to 1 at each level.

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
