"""Answers of a scene for the page: what the shader needs to light up the Gaussians of a text."""

from __future__ import annotations

import base64
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from scoup.query.coded_scene import CodedScene
from scoup.query.presence import scene_z_scores, with_evidence
from scoup.query.question import Question
from scoup.query.select import Selection, level_thresholds, select_by_relevancy
from scoup.query.things import ThingFits, thing_fits, things_of_scene
from scoup.view.unit_codes import atom_scores


@dataclass(frozen=True, eq=False)
class PageAnswer:
    """The answer of a scene to one text, as the page takes it. The level and the Gaussians are those of `scoup select`.

    Things answer where the field has them and they are convincing; the votes of the Gaussians answer otherwise, and
    wherever the page is given a threshold.
    """

    text: str
    scores: Tensor  # [S, L] float32, inner products of atoms and text
    level: int  # position of the level that answers
    score: float  # the largest relevancy of a Gaussian at that level; minus infinity if none has a code
    thresholds: Tensor  # [S] stable threshold of each level, on the rescaled relevancy
    spans: Tensor  # [S, 2] relevancies that rescaling takes to 0 and 1 at each level
    z_score: float | None  # None if presence is not judged
    present: bool  # true if presence is not judged
    gaussians: int  # how many answer
    chosen_things: list[int] | None  # that answer if no level is chosen; None where the votes answer
    things: list[list[int] | None]  # per level, that answer if it is chosen; None where the votes answer

    def record(self) -> dict[str, Any]:
        """Return plain JSON values; ``scores`` as base64 of float32, little-endian."""
        judged = self.z_score is not None and math.isfinite(self.z_score)
        return {
            "text": self.text,
            "level": self.level,
            "score": round(self.score, 4) if math.isfinite(self.score) else None,
            "z_score": round(self.z_score or 0.0, 3) if judged else None,
            "present": self.present,
            "thresholds": [round(value, 4) for value in self.thresholds.tolist()],
            "spans": [[round(low, 6), round(high, 6)] for low, high in self.spans.tolist()],
            "gaussians": self.gaussians,
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
    present_from = question.present_from
    coded = field.coded_levels().cpu()
    scores = atom_scores(field, question.queries)
    fits = thing_fits(field, question)
    for number, text in enumerate(question.texts):
        own = scores[:, :, number : number + 1].contiguous()
        query = question.queries[number : number + 1]
        relevancy = field.gaussian_relevancy(query, question.canonical)[:, 0].cpu()
        found = select_by_relevancy(relevancy, coded)
        z_score = None
        if present_from is not None:
            z_score = float(scene_z_scores(field, [found], query, question.everyday)[0])
        own_things, of_levels = None, [None] * len(relevancy)
        if fits is not None:
            own_things = things_of_scene(fits, number, found.mask)
            of_levels = _things_of_levels(fits, number, relevancy, coded)
            found = found if own_things is None else _selected_things(fits, own_things, relevancy)
            z_score = None if z_score is None else z_score + fits.presence(number)
        z_score = None if z_score is None else with_evidence(z_score, found.mask)
        yield PageAnswer(
            text=text,
            scores=own[:, :, 0],
            level=found.level,
            score=found.score,
            thresholds=level_thresholds(relevancy, coded),
            spans=spans(relevancy, coded),
            z_score=z_score,
            present=present_from is None or z_score is None or z_score >= present_from,
            gaussians=int(found.mask.sum()),
            chosen_things=None if own_things is None else own_things.tolist(),
            things=[None if each is None else each.tolist() for each in of_levels],
        )


def _things_of_levels(fits: ThingFits, query: int, relevancy: Tensor, coded: Tensor) -> list[Tensor | None]:
    """Return the things that answer a text if one level is chosen, level by level; relevancy and coded [S, N]."""
    found = []
    for level in range(len(relevancy)):
        rows = slice(level, level + 1)
        voted = select_by_relevancy(relevancy[rows], coded[rows]).mask
        found.append(things_of_scene(fits, query, voted, level))
    return found


def _selected_things(fits: ThingFits, chosen: Tensor, relevancy: Tensor) -> Selection:
    """Return the Gaussians of some things of one level, in the place of those that the votes select."""
    mask, level = fits.things.members(chosen).cpu(), int(fits.things.levels[chosen[0]])
    score = float(relevancy[level][mask].max()) if bool(mask.any()) else -math.inf
    return Selection(mask, relevancy[level], level, score, None)


def spans(relevancy: Tensor, coded: Tensor) -> Tensor:
    """Return [S, 2]: the relevancies that ``scoup.query.smoothing.rescale`` takes to 0 and to 1 at each level.

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
