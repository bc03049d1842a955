"""Labels: one of several words per Gaussian."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from scoup.base.errors import InputError, UnknownNameError
from scoup.base.html import card
from scoup.query.answer import Answer
from scoup.query.answering import answer_scene
from scoup.query.coded_scene import CodedScene
from scoup.query.question import Question

NONE = -1
"""The id of a Gaussian that no word fits."""
NONE_NAME = "none"


@dataclass(frozen=True, eq=False, repr=False)
class GaussianLabels:
    """The class of every Gaussian. Tensors are on the CPU.

    Example:
        >>> field = scoup.LanguageField.load("f.scoup")
        >>> labels = field.label(field.question(["kettle", "wooden table"], always=True))
        >>> labels.names
        ('kettle', 'wooden table')
    """

    ids: Tensor
    """[N] int32, the position of a word in ``names``; -1 for none of them."""
    names: tuple[str, ...]
    """Q words."""
    scores: tuple[float | None, ...]
    """Per word, as of ``Answer``; None with too few everyday words."""
    presence: tuple[bool, ...]
    """Per word, whether the thing is in the scene; true if that was not judged."""
    levels: tuple[str, ...]
    """Per word, the name of the level that answers it."""
    things: tuple[tuple[int, ...], ...]
    """Per word, the numbers of the things that answer it (``field.things`` describes them); empty where the votes
    answer, and for what is not there."""

    def __repr__(self) -> str:
        counts = ", ".join(f"{name}: {count:,}" for name, count in self.counts().items())
        return f"GaussianLabels({len(self.ids):,} Gaussians; {counts})"

    def _repr_html_(self) -> str:
        return card(f"Labels of {len(self.ids):,} Gaussians", self.counts())

    def mask(self, name: str) -> Tensor:
        """Return the Gaussians of a word, or of "none", [N] boolean.

        Raises:
            UnknownNameError: it is another word.
        """
        if name in self.names:
            return self.ids == self.names.index(name)
        if name == NONE_NAME:
            return self.ids == NONE
        raise UnknownNameError("class", name, (*self.names, NONE_NAME))

    def counts(self) -> dict[str, int]:
        """Return the number of Gaussians per word, and of "none"."""
        found = torch.bincount(self.ids.long() + 1, minlength=len(self.names) + 1).tolist()
        return {**dict(zip(self.names, found[1:], strict=True)), NONE_NAME: found[0]}


def label(field: CodedScene, question: Question) -> GaussianLabels:
    """Return the word that fits each Gaussian best, or "none"; ``field.label`` calls this.

    A word applies to the Gaussians that ``answer_scene`` returns for it. Of several words for one Gaussian, the one
    answered by the finest level counts, for the name of a part says more than that of its whole; of words of one level
    the one with the largest score.
    """
    names = question.texts
    if len(set(names)) < len(names) or NONE_NAME in names:
        raise InputError(
            f"labels need words that differ from each other and from {NONE_NAME!r} (got {', '.join(names)})"
        )
    answers = answer_scene(field, question)
    return GaussianLabels(
        labels_of_answers(answers, field.levels),
        names,
        tuple(answer.score for answer in answers),
        tuple(answer.presence for answer in answers),
        tuple(answer.level for answer in answers),
        tuple(answer.things for answer in answers),
    )


def labels_of_answers(answers: Sequence[Answer], levels: Sequence[str]) -> Tensor:
    """Return the number of the word of each Gaussian, [N] int32, ``NONE`` for none."""
    ids = torch.full((len(answers[0].mask),), NONE, dtype=torch.int32)
    # The word that counts comes last and overwrites the others; of equals the first word counts.
    order = sorted(
        range(len(answers)),
        key=lambda number: (-levels.index(answers[number].level), answers[number].score or 0.0, -number),
    )
    for number in order:
        ids[answers[number].mask] = number
    return ids
