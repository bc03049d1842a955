"""One of several words for each Gaussian."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from scoup.base.errors import InputError, UnknownNameError
from scoup.base.html import card
from scoup.query.answering import judged_selections
from scoup.query.coded_scene import CodedScene
from scoup.query.question import Question
from scoup.query.select import Selection

NONE = -1
"""The class of a Gaussian that none of the words fits."""
NONE_NAME = "none"


@dataclass(frozen=True, eq=False, repr=False)
class GaussianLabels:
    """The class of every Gaussian. Tensors are on the CPU.

    Attributes:
        ids: [N] int32, the position of a word in ``names``; -1 for none of them.
        names: Q words.
        scores: [N] float32 relevancy to the word; minus infinity for none of them.
        z_scores: per word, as in ``Answer``; None if presence was not judged.
        presence: per word, whether the thing is in the scene; true if that was not judged.
        levels: per word, the name of the level that answers it.

    Example:
        >>> field = scoup.LanguageField.load("f.scoup")
        >>> labels = field.label(field.question(["kettle", "wooden table"], always=True))
        >>> labels.names
        ('kettle', 'wooden table')
    """

    ids: Tensor  # [N]
    names: tuple[str, ...]
    scores: Tensor  # [N]
    z_scores: tuple[float, ...] | None
    presence: tuple[bool, ...]
    levels: tuple[str, ...]

    def __repr__(self) -> str:
        counts = ", ".join(f"{name}: {count:,}" for name, count in self.counts().items())
        return f"GaussianLabels({len(self.ids):,} Gaussians; {counts})"

    def _repr_html_(self) -> str:
        return card(f"Labels of {len(self.ids):,} Gaussians", self.counts())

    def mask(self, name: str) -> Tensor:
        """[N] boolean: the Gaussians of a word, or of "none".

        Raises:
            InputError: it is none of the words.
        """
        if name in self.names:
            return self.ids == self.names.index(name)
        if name == NONE_NAME:
            return self.ids == NONE
        raise UnknownNameError("class", name, (*self.names, NONE_NAME))

    def counts(self) -> dict[str, int]:
        """How many Gaussians each word has, and "none"."""
        found = torch.bincount(self.ids.long() + 1, minlength=len(self.names) + 1).tolist()
        return {**dict(zip(self.names, found[1:], strict=True)), NONE_NAME: found[0]}


def label(field: CodedScene, question: Question) -> GaussianLabels:
    """Return the word that fits each Gaussian best, of several, or none; ``field.label`` calls this.

    A word fits the Gaussians that ``answer_scene`` gives for it, unless the thing is not in the scene. Of several
    words that fit, the one that a finer level answers counts, for the name of a part says more than that of its whole;
    of words of one level the most relevant, which is the one with the largest cosine.

    Raises:
        InputError: the vectors do not fit the field, a word is given twice or is "none", or there are too few everyday
            words to judge presence.
    """
    names, present_from = question.texts, question.present_from
    if len(set(names)) < len(names) or NONE_NAME in names:
        raise InputError(f"labels need words that differ, and other than {NONE_NAME!r}: {', '.join(names)}")
    judged: list[float] = []
    presence: list[bool] = []
    levels: list[str] = []

    def there() -> Iterator[tuple[Selection, bool]]:
        """The selections one after the other, so that only one relevancy is in memory, and whether each counts."""
        for found, z_score in judged_selections(field, question):
            if z_score is not None:
                judged.append(z_score)
            presence.append(present_from is None or judged[-1] >= present_from)
            levels.append(field.levels[found.level])
            yield found, presence[-1]

    ids, scores = label_by_selections(there(), len(field), field.codebook.device)
    z_scores = tuple(judged) if present_from is not None else None
    return GaussianLabels(ids.cpu(), names, scores.cpu(), z_scores, tuple(presence), tuple(levels))


def label_by_selections(
    found: Iterable[tuple[Selection, bool]], count: int, device: torch.device | str = "cpu"
) -> tuple[Tensor, Tensor]:
    """``label`` from what each word selects, whatever that comes from.

    Args:
        found: of each word the selection, and whether it counts.
        count: N, of Gaussians.
        device: of the selections.

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
