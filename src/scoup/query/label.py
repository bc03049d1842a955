"""One of several words for each Gaussian."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from scoup.base.errors import InputError, UnknownNameError
from scoup.base.html import card
from scoup.query.presence import scene_z_scores
from scoup.query.queried_field import QueriedField
from scoup.query.select import select_each
from scoup.query.text_vectors import TextVectors

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
    """

    ids: Tensor  # [N]
    names: tuple[str, ...]
    scores: Tensor  # [N]
    z_scores: tuple[float, ...] | None
    presence: tuple[bool, ...]

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


def label(
    field: QueriedField,
    texts: TextVectors,
    threshold: float | None = None,
    present_from: float | None = None,
) -> GaussianLabels:
    """The word that fits each Gaussian best, of several, or none.

    A word fits the Gaussians that ``select`` would choose for it, unless the thing is not in the scene; of several
    words that fit, the most relevant one counts, each at the level chosen for it.

    Args:
        field: to be queried.
        texts: the words, and what they are compared with.
        threshold: see ``select``; None: of each word the most stable one.
        present_from: the z-score from which a thing counts as present; None: presence is not judged.

    Raises:
        InputError: the vectors do not fit the field, a word is given twice or is "none", or there are too few everyday
            words to judge presence.
    """
    if len(set(texts.texts)) < len(texts.texts) or NONE_NAME in texts.texts:
        raise InputError(
            f"labels need words that differ, and other than {NONE_NAME!r}: {', '.join(texts.texts)}"
        )
    best = torch.full((len(field),), -torch.inf, device=field.codebook.device)
    ids = torch.full((len(field),), NONE, dtype=torch.int32, device=field.codebook.device)
    judged: list[float] = []
    presence: list[bool] = []
    for number, found in enumerate(select_each(field, texts.queries, texts.canonical, threshold)):
        if present_from is not None:
            query = texts.queries[number : number + 1]
            judged.append(float(scene_z_scores(field, [found], query, texts.everyday)))
        presence.append(present_from is None or judged[-1] >= present_from)
        better = found.mask & (found.relevancy > best) & presence[-1]
        best = torch.where(better, found.relevancy, best)
        ids[better] = number
    z_scores = tuple(judged) if present_from is not None else None
    return GaussianLabels(ids.cpu(), texts.texts, best.cpu(), z_scores, tuple(presence))
