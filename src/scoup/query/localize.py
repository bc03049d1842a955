"""The point of a view that fits a query best (docs/protocols.md, LERF-OVS, "Localisation")."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from numpy.typing import ArrayLike
from torch import Tensor

from scoup.base.brief import brief
from scoup.base.errors import InputError
from scoup.query.presets import QUERY_PRESETS, QueryPreset
from scoup.query.smoothing import box_mean


@dataclass(frozen=True, eq=False)
class Localization:
    """The most relevant place in a view."""

    pixels: Tensor
    """[M, 2] int64 (x, y), all pixels of maximal averaged relevancy, M >= 1, row by row."""
    pixel: tuple[int, int]
    """(x, y), the pixel of them nearest to their mean."""
    level: int
    """Position of the level chosen."""
    score: float
    """The maximum, 0..1."""

    __repr__ = brief


def localize(
    relevancy: Tensor | ArrayLike,
    preset: QueryPreset = QUERY_PRESETS["default"],
    averaged: Tensor | None = None,
) -> Localization:
    """Return the most relevant place in one view.

    Each level is averaged by the preset's box; the level with the largest maximum is chosen, the first of equals,
    whatever the preset's ``level_choice``.

    Args:
        relevancy: [S, H, W] of one query, 0..1.
        preset: its box is used.
        averaged: ``averaged_relevancy`` of both, if known.

    Raises:
        InputError: relevancy has another shape, or is empty.

    Example:
        >>> relevancy = torch.zeros(3, 20, 30)  # levels, rows, columns
        >>> relevancy[1, 4:9, 10:15] = 0.9
        >>> found = scoup.localize(relevancy)
        >>> found.level
        1
    """
    relevancy = torch.as_tensor(relevancy)
    averaged = averaged_relevancy(relevancy, preset) if averaged is None else averaged
    peaks = averaged.flatten(1).amax(1)
    level = int(peaks.argmax())
    pixels = (averaged[level] == peaks[level]).nonzero().flip(1)
    return Localization(pixels, best_pixel(averaged[level]), level, float(peaks[level]))


def best_pixel(values: Tensor, mask: Tensor | None = None) -> tuple[int, int]:
    """Return (x, y) of the largest value [H, W], within a mask unless it is empty; of equals the one nearest to their
    mean.
    """
    if mask is not None and mask.any():
        values = torch.where(mask, values, -torch.inf)
    pixels = (values == values.max()).nonzero().flip(1)
    # A pixel in the middle of a plateau says more than its first corner.
    offsets = pixels.double() - pixels.double().mean(0)
    x, y = pixels[int(offsets.square().sum(1).argmin())].tolist()
    return x, y


def averaged_relevancy(relevancy: Tensor, preset: QueryPreset) -> Tensor:
    """Return the means [S, H, W] of relevancy over the preset's box, which ``localize`` and ``segment`` both use."""
    if relevancy.dim() != 3 or 0 in relevancy.shape:
        raise InputError(
            f"relevancy of one query must be [S, H, W] and not empty, got {list(relevancy.shape)}"
        )
    return box_mean(relevancy, preset.kernel, preset.border)
