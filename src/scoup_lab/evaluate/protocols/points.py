"""Scores by point: the class that a field gives each Gaussian, and its comparison with the true class
(``scannet``; docs/evaluation.md).

All of it counts points: a class that the truth lacks has no score, whatever was given.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from scoup.base import InputError
from scoup.query import TextVectors
from scoup_lab.baselines.fitted import FittedMethod

NO_CLASS = -1
"""In truths: a point that does not count. In answers: a point that was given no class."""
QUERIES_AT_A_TIME = 16  # relevancy of all Gaussians to so many classes is in memory together


@dataclass(frozen=True)
class ClassList:
    """The classes of a benchmark; their names are the texts that are queried."""

    name: str  # as on the command line
    classes: tuple[str, ...]  # what the truth numbers from 0


def label_gaussians(
    fitted: FittedMethod, vectors: TextVectors, texts: Sequence[str], level: int | None = None
) -> Tensor:
    """Return [N] int64 position of the text that fits each Gaussian best; ``NO_CLASS`` where nothing is known of it.

    At one level this is the argmax of the cosine, as in the protocols: relevancy grows with the cosine, and the
    canonical phrases are the same for all texts. *Choice*: of several levels, each Gaussian is answered by the one
    where a text leads the canonical phrases by most, which is its largest relevancy. Nothing is smoothed, and nothing
    is judged absent. Of equals the first text is taken.

    ``texts``: Q >= 1, one a class; ``level``: the position of the only level that answers; None for all.
    """
    coded = fitted.coded()
    if level is not None and not 0 <= level < len(coded):
        raise InputError(f"there is no level {level} among {len(coded)}")
    rows = slice(None) if level is None else slice(level, level + 1)
    coded = coded[rows]
    best = torch.full(coded.shape[1:], -torch.inf, device=coded.device)
    classes = torch.full(coded.shape[1:], NO_CLASS, dtype=torch.int64, device=coded.device)
    for start in range(0, len(texts), QUERIES_AT_A_TIME):
        queries = vectors.of(texts[start : start + QUERIES_AT_A_TIME])
        relevancy = fitted.gaussian_relevancy(queries, vectors.canonical)[rows].to(coded.device)
        # A Gaussian without a code at a level has a relevancy of 0.5 there, which says nothing.
        values, positions = relevancy.masked_fill(~coded[:, None], -torch.inf).amax(0).max(0)
        better = values > best
        best = torch.where(better, values, best)
        classes[better] = positions[better] + start
    return classes


def confusion_matrix(truth: Tensor, given: Tensor, n_classes: int) -> Tensor:
    """Return [C, C + 1] int64: how many points of each true class (row) were given each class; last column: none.

    ``truth``: [P] int64; points of ``NO_CLASS`` do not count; ``given``: [P] int64.
    """
    if truth.shape != given.shape or truth.dim() != 1:
        raise InputError(
            f"{list(truth.shape)} true classes and {list(given.shape)} given; expected one per point"
        )
    for numbers in (truth, given):
        if len(numbers) and not NO_CLASS <= int(numbers.min()) <= int(numbers.max()) < n_classes:
            raise InputError(
                f"classes are numbered {NO_CLASS} to {n_classes - 1}, not {int(numbers.min())} to "
                f"{int(numbers.max())}"
            )
    counted = truth != NO_CLASS
    columns = torch.where(given == NO_CLASS, n_classes, given)
    cells = truth[counted] * (n_classes + 1) + columns[counted]
    return torch.bincount(cells, minlength=n_classes * (n_classes + 1)).view(n_classes, n_classes + 1)


def class_totals(matrix: Tensor) -> Tensor:
    """Return [3, C] float64 of a confusion matrix [C, C + 1]: for each class the points that were found, that
    truly have it, and that were given it. Those of scenes may be added."""
    square = matrix[:, :-1].double()
    return torch.stack([square.diagonal(), matrix.double().sum(1), square.sum(0)])


def class_ious(totals: Tensor) -> Tensor:
    """Return [..., C] intersection over union of each class from totals [..., 3, C]; NaN where no point
    truly has it."""
    correct, true, given = totals.unbind(-2)
    return torch.where(true > 0, correct / (true + given - correct), torch.nan)


def class_accuracies(totals: Tensor) -> Tensor:
    """Return [..., C] share of each class's points that were found; NaN where there are none."""
    correct, true, _ = totals.unbind(-2)
    return torch.where(true > 0, correct / true, torch.nan)


def class_mean(values: Tensor) -> Tensor:
    """Return [...] mean of [..., C] over the classes that have a value; NaN where there is none."""
    return values.nanmean(-1)
