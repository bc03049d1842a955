"""Labels: one of several words per Gaussian."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from scoup.base.errors import InputError, UnknownNameError
from scoup.base.html import card
from scoup.query.answering import judged_selections
from scoup.query.coded_scene import CodedScene
from scoup.query.locate import answering_things
from scoup.query.question import Question
from scoup.query.select import Selection

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
    scores: Tensor
    """[N] float32 relevancy to the word; minus infinity for none of them."""
    z_scores: tuple[float, ...] | None
    """Per word, as in ``Answer``; None if presence was not judged."""
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

    A word fits the Gaussians that ``answer_scene`` returns for it. Of several words that fit, the one answered by the
    finest level counts, for the name of a part says more than that of its whole; of words of one level the most
    relevant.
    """
    names, present_from = question.texts, question.present_from
    if len(set(names)) < len(names) or NONE_NAME in names:
        raise InputError(
            f"labels need words that differ from each other and from {NONE_NAME!r} (got {', '.join(names)})"
        )
    judged: list[float] = []
    presence: list[bool] = []
    levels: list[str] = []
    things: list[tuple[int, ...]] = []

    def selections() -> Iterator[tuple[Selection, bool]]:
        """One after the other, so that only one relevancy is in memory."""
        for found, z_score in judged_selections(field, question):
            if z_score is not None:
                judged.append(z_score)
            presence.append(present_from is None or judged[-1] >= present_from)
            levels.append(field.levels[found.level])
            numbers = answering_things(field, found.mask, found.level, found.threshold)
            things.append(tuple(numbers.tolist()) if presence[-1] and numbers is not None else ())
            yield found, presence[-1]

    ids, scores = label_by_selections(selections(), len(field), field.codebook.device)
    z_scores = tuple(judged) if present_from is not None else None
    return GaussianLabels(
        ids.cpu(), names, scores.cpu(), z_scores, tuple(presence), tuple(levels), tuple(things)
    )


def label_by_selections(
    found: Iterable[tuple[Selection, bool]], count: int, device: torch.device | str = "cpu"
) -> tuple[Tensor, Tensor]:
    """Label ``count`` Gaussians by the selection of each word, and whether it counts.

    Returns:
        [N] int32 numbers of words, ``NONE`` for none, and [N] float32 relevancy to them.
    """
    best = torch.full((count,), -torch.inf, device=device)
    ids = torch.full((count,), NONE, dtype=torch.int32, device=device)
    finest = torch.full((count,), torch.iinfo(torch.int32).max, dtype=torch.int32, device=device)
    for number, (each, counts) in enumerate(found):
        finer, as_fine = each.level < finest, each.level == finest
        better = each.mask & (finer | (as_fine & (each.relevancy > best))) & counts
        best = torch.where(better, each.relevancy, best)
        ids[better] = number
        finest[better] = each.level
    return ids, best
