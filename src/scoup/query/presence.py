"""Presence: whether the thing is there at all, so that a query for something absent can return nothing.

Every text fits something best. What its fit is worth, the scene itself says: a list of everyday words, nearly all of
which name nothing in it, fits the same things (the scene's own null). So

    score = share of everyday words whose best fit in this scene is lower, 0 to 1.

It has no unit, and means the same in every scene, for every embedding model, for a text and for a single thing.
What is absent often fits a thing that many words are nearer to: of their share, ``constants.MOST_SCORES`` are the most
that a text scores in the scene. Other names of the text do not count among the words. A text is present from a score of
``constants.PRESENT_FROM`` on and with at least ``LEAST_GAUSSIANS`` Gaussians. This is ours; neither the paper nor the
protocols judge presence. Measured in docs/answers.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from numbers import Real
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import torch
from torch import Tensor

from scoup.base import InputError, counted
from scoup.field import LEAST_GAUSSIANS
from scoup.models import LEAST_WORDS
from scoup.query import constants

if TYPE_CHECKING:
    from scoup.query.named import Named
    from scoup.query.question import Question

Certainty = Literal["sure", "likely", "doubtful", "not here"]


def certainty(score: float | None, presence: bool) -> Certainty | None:
    """Return a score in words, for people; None if presence was not judged."""
    if score is None:
        return None
    if not presence:
        return "not here"
    return "sure" if score >= constants.SURE else "likely" if score >= constants.LIKELY else "doubtful"


def said_score(score: float, present_from: float | None) -> str:
    """Return a score with two digits, rounded down where a score below a bound would read as one that reaches it."""
    rounded = float(f"{score:.2f}")
    bounds = (constants.LIKELY, constants.SURE, present_from or 0.0)
    return f"{rounded - 0.01 * any(score < bound <= rounded for bound in bounds):.2f}"


def check_share(name: str, value: float | None) -> None:
    """Refuse a value that is not a number from 0 to 1; None passes."""
    if value is not None and not (isinstance(value, Real) and 0 <= value <= 1):
        raise InputError(f"{name} must be 0 to 1, got {value}")


def presence_threshold(n_words: int, source: str, wanted: float | None = None) -> float | None:
    """Return the score from which a text counts as present, by default ``constants.PRESENT_FROM``; None with too few
    everyday words to judge it. Messages name their ``source``."""
    check_share("the least score of presence", wanted)
    if n_words >= LEAST_WORDS:
        return constants.PRESENT_FROM if wanted is None else wanted
    if wanted is not None:
        raise InputError(
            f"{source}: has {counted(n_words, 'word')}, but presence is judged against {LEAST_WORDS} "
            "or more; add any words to the table"
        )
    return None


def is_present(score: float | None, n_gaussians: int, present_from: float | None) -> bool:
    """Return whether a text with this score and so many Gaussians is in the scene; true if that is not judged."""
    if present_from is None:
        return True
    return score is not None and score >= present_from and n_gaussians >= LEAST_GAUSSIANS


def other_words(queries: Tensor, words: Tensor) -> Tensor:
    """Return the words [B, D] that queries [Q, D] are compared with, [Q, B] boolean: all but other names of the query.

    Vectors have unit norm.
    """
    near = queries @ words.T
    alike = near > near.mean(1, keepdim=True) + constants.OTHER_NAME * near.std(1, keepdim=True)
    return ~alike & (near < constants.SAME_WORD)


class TextScore:
    """The score of one text for fits in S scenes: against the best fits of everyday words, the share of these that are
    nearer to what fits best, and by its name if it has one.

    Args:
        best_fits: [S, B] of the words in each scene.
        others: [B] boolean, the words that count (``other_words``).
        named: by scene, what a model with words said of the text.
        nearer: returns for a scene the cosines [B] of its best thing with the words, less that with the text.
    """

    def __init__(
        self,
        best_fits: Tensor,
        others: Tensor,
        named: Mapping[int, Named] | None = None,
        nearer: Callable[[int], Tensor] | None = None,
    ) -> None:
        self._best, self._others = best_fits[:, others], others
        self._named, self._nearer = named or {}, nearer
        self._most: dict[int, float] = {}

    def __call__(self, fit: float, thing: int | None = None) -> float | None:
        """Return the score of one fit in the first scene, of the text, or of it in one thing."""
        return self.each([fit], [0], [thing])[0]

    def each(
        self, fits: Sequence[float], scenes: Sequence[int], things: Sequence[int | None] | None = None
    ) -> list[float | None]:
        """Return for each fit the share of the words whose best fit in its scene is lower, at most what the text may
        score there, or None if no word counts, joined with the score of the name (``Named.score``): of the text, or of
        it in one thing."""
        scores: list[float | None] = [None] * len(fits)
        if count := self._best.shape[1]:
            lower = (self._best[[*scenes]] < torch.tensor(fits)[:, None]).sum(1).tolist()
            scores = [
                self._lowered(number / count, scene) for number, scene in zip(lower, scenes, strict=True)
            ]
        for index, scene in enumerate(scenes if self._named else ()):
            if scene in self._named:
                thing = None if things is None else things[index]
                scores[index] = self._named[scene].score(scores[index], thing)
        return scores

    def _lowered(self, share: float, scene: int) -> float:
        if self._nearer is None or share <= constants.MOST_SCORES[-1]:
            return share
        if scene not in self._most:
            nearer = float((self._nearer(scene)[self._others] > 1e-6).double().mean())
            self._most[scene] = float(np.interp(nearer, constants.NEARER_SHARES, constants.MOST_SCORES))
        return min(share, self._most[scene])


def text_scores(
    question: Question[Any],
    best_fits: Tensor,
    named: Sequence[Mapping[int, Named]] = (),
    nearer: Sequence[Callable[[int], Tensor]] = (),
) -> list[TextScore]:
    """Return the score of each text against the best fits of everyday words [S, B], joined with those of its names in
    the scenes; with too few words, none counts."""
    queries, nothing = question.queries.float().cpu(), [None] * len(question.texts)
    others = torch.zeros(len(queries), 0, dtype=torch.bool)
    if question.can_judge_presence:
        others = other_words(queries, question.everyday.float().cpu())
    every = zip(others, named or nothing, nearer or nothing, strict=True)
    return [TextScore(best_fits[:, : len(each)], each, names, of) for each, names, of in every]
