"""The Gaussians that answer a query by their own codes, without rendering (docs/protocols.md, "3D-selection")."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from scoup.base.errors import InputError
from scoup.query.neighbours import Neighbourhood
from scoup.query.queried_field import QueriedField
from scoup.query.smoothing import rescale


@dataclass(frozen=True, eq=False)
class Selection:
    """The Gaussians that one query selects.

    Attributes:
        mask: [N] boolean.
        relevancy: [N] float32 at the level chosen, blended with neighbours if that was wanted.
        level: position of the level chosen.
        score: the largest relevancy of a Gaussian with a code at that level; minus infinity if there is none.
    """

    mask: Tensor  # [N]
    relevancy: Tensor  # [N]
    level: int
    score: float


def select(
    field: QueriedField,
    queries: Tensor,  # [D] or [Q, D]
    canonical: Tensor,  # [P, D]
    threshold: float = 0.6,
    neighbours: int | None = None,
    rescaled: bool = True,
) -> Tensor:
    """The Gaussians that answer one or several queries.

    Per query the level with the largest relevancy is chosen, after blending with neighbours if that is wanted.
    Gaussians without a code at that level are never selected.

    Args:
        field: the language field; its geometry is needed only for ``neighbours``.
        queries: [D] or [Q, D] unit-norm text embeddings.
        canonical: [P, D] unit-norm embeddings of the canonical phrases.
        threshold: a Gaussian is selected above this.
        neighbours: blend each Gaussian's relevancy half and half with the mean of so many nearest coded
            neighbours (10 in VALA-3D); None: do not.
        rescaled: stretch the relevancy of the level as ``rescale`` does before it meets the threshold, as in
            VALA-3D; otherwise the threshold is on the relevancy itself, and nothing may pass it.

    Returns:
        Boolean [N], or [Q, N] for [Q, D].

    Raises:
        InputError: shapes do not fit, ``neighbours`` is below 1, or the threshold is not 0 to 1.
    """
    rows = queries if queries.dim() == 2 else queries[None]
    masks = [found.mask for found in select_each(field, rows, canonical, threshold, neighbours, rescaled)]
    if queries.dim() == 1:
        return masks[0]
    return torch.stack(masks) if masks else field.code_weights.new_zeros(0, len(field.code_weights)).bool()


def select_each(
    field: QueriedField,
    queries: Tensor,  # [Q, D]
    canonical: Tensor,  # [P, D]
    threshold: float = 0.6,
    neighbours: int | None = None,
    rescaled: bool = True,
) -> Iterator[Selection]:
    """``select`` query by query, with level and relevancy; arguments and errors as there."""
    if neighbours is not None and neighbours < 1:
        raise InputError(f"neighbours must be at least 1, got {neighbours}")
    if not 0 <= threshold <= 1:
        raise InputError(f"the threshold must be 0 to 1, got {threshold}")
    coded = (field.code_weights > 0).any(-1).T  # [S, N]
    around = Neighbourhood.of(field.gaussians.means, coded.any(0), neighbours) if neighbours else None
    for query in queries:
        relevancy = field.gaussian_relevancy(query[None], canonical)[:, 0]
        yield select_by_relevancy(relevancy, coded, around, threshold, rescaled)


def select_by_relevancy(
    relevancy: Tensor,  # [S, N]
    coded: Tensor,  # [S, N]
    around: Neighbourhood | None = None,
    threshold: float = 0.6,
    rescaled: bool = True,
) -> Selection:
    """``select`` for one query from its relevancy, whatever that comes from.

    Args:
        relevancy: [S, N] of every Gaussian at every level.
        coded: [S, N] boolean, those that may be selected.
        around: neighbours to blend with.
        threshold, rescaled: see ``select``.
    """
    values = relevancy if around is None else around.blend(relevancy, coded)
    masked = torch.where(coded, values, -torch.inf)
    peaks = masked.amax(1) if masked.shape[1] else masked.new_full((len(masked),), -torch.inf)
    level = int(peaks.argmax())
    mask = torch.zeros_like(coded[level])
    members = coded[level]
    if members.any():
        candidates = values[level, members]
        mask[members] = (rescale(candidates) if rescaled else candidates) > threshold
    return Selection(mask, values[level], level, float(peaks[level]))
