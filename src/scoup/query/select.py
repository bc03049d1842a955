"""The Gaussians that answer an expression, such as "mug and not handle" or "mug left of the laptop"."""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from scoup.base import InputError
from scoup.field import Field
from scoup.query.answer import ExpressionAnswer, answer_relevancy
from scoup.query.ask import one_answer
from scoup.query.question import Question
from scoup.query.things import LONGEST_LINK, NEIGHBOURS, connected_parts
from scoup.scene import Gaussians, nearest_points

MOST_STEPS = 1000


@dataclass(frozen=True)
class Reshaping:
    """Changes to a selection, applied in this order.

    Raises:
        InputError: a number is negative, not finite or beyond ``MOST_STEPS``.

    Example:
        >>> field = scoup.LanguageField.load("f.scoup")
        >>> question = field.question("kettle", always=True)
        >>> whole, largest = field.select(question), field.select(question, scoup.Reshaping(largest=True))
        >>> bool(largest.mask.sum() <= whole.mask.sum())
        True
    """

    largest: bool = False
    """Keep only the connected part that weighs most, as the first of ``field.things`` in a field without things."""
    shrink: int = 0
    """Remove the Gaussians that have a neighbour outside, so many times."""
    grow: int = 0
    """Add the neighbours of those inside, so many times."""
    within: float = 0.0
    """Add every Gaussian whose centre is at most this far from the centre of one inside, in world units."""

    def __post_init__(self) -> None:
        for name in ("shrink", "grow"):
            if not 0 <= getattr(self, name) <= MOST_STEPS:
                raise InputError(f"{name} must be 0 to {MOST_STEPS}, got {getattr(self, name)}")
        if not (self.within >= 0 and math.isfinite(self.within)):
            raise InputError(f"within must be a distance of 0 or more, got {self.within}")


def select(field: Field, question: Question[Any], reshaping: Reshaping | None = None) -> ExpressionAnswer:
    """Return one answer to all that a question asks for; ``LanguageField.select`` documents it."""
    wanted = reshaping or Reshaping()

    def made() -> ExpressionAnswer:
        whole = one_answer(field, question)
        if wanted == Reshaping():
            return whole
        mask = reshaped(field.gaussians, whole.mask, answer_relevancy(field, whole), wanted)
        return replace(whole, mask=mask)

    return copy.deepcopy(field.kept((select, question, wanted), made))


def reshaped(gaussians: Gaussians, mask: Tensor, relevancy: Tensor, wanted: Reshaping) -> Tensor:
    """Reshape a selection, ``mask`` [N] boolean, whose parts weigh relevancy [N] times opacity.

    Neighbours of a Gaussian are the ``NEIGHBOURS`` nearest that are not much further away than usual among those
    inside. Gaussians that are not finite have none, and are not added.
    """
    means = gaussians.means.cpu().double()
    usable = torch.isfinite(means).all(1)
    inside = (mask.cpu() & usable)[usable].numpy()
    points = means[usable].numpy()
    if wanted.largest and inside.any():
        weights = (gaussians.opacities.cpu().double().clamp(0, 1) * relevancy.cpu().double())[usable].numpy()
        parts = connected_parts(points[inside])
        is_heaviest = parts == np.bincount(parts, np.nan_to_num(weights[inside])).argmax()
        inside[inside] = is_heaviest
    if (wanted.shrink or wanted.grow) and inside.any() and len(points) > 1:
        nearest, lengths = nearest_points(points, min(NEIGHBOURS, len(points) - 1))
        linked = lengths <= LONGEST_LINK * np.median(lengths[inside][:, -1])
        for _ in range(wanted.shrink):
            inside &= ~((~inside)[nearest] & linked).any(1)
        for _ in range(wanted.grow):
            inside |= (inside[nearest] & linked).any(1)
    if wanted.within and inside.any():
        from scipy.spatial import KDTree

        nearest = KDTree(points[inside]).query(points, workers=-1)[0]
        inside |= np.asarray(nearest) <= wanted.within
    out = torch.zeros(len(mask), dtype=torch.bool)
    out[usable] = torch.from_numpy(inside)
    return out
