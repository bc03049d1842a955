"""Directions: embeddings of regions and of texts, whose norms do not matter."""

from __future__ import annotations

import torch
from numpy.typing import ArrayLike
from torch import Tensor

from scoup.base import InputError

NEARLY_UNIT = 1e-5
"""Rows whose norm is this near to 1 are left as they are, to the last bit."""


def float_rows(vectors: Tensor | ArrayLike, what: str) -> Tensor:
    """Return [R, D] float32 of a floating-point tensor or array, checked; ``what`` is its name in messages."""
    rows = torch.as_tensor(vectors).detach()
    if rows.dim() != 2 or rows.shape[1] == 0:
        raise InputError(f"{what} must be [R, D], got {list(rows.shape)}")
    if not rows.is_floating_point():
        raise InputError(f"{what} must be floating-point numbers, got {rows.dtype}")
    rows = rows.float()
    # A value that is not finite makes the sum not finite: check single values only then.
    if not torch.isfinite(rows.abs().sum()):
        bad = ~torch.isfinite(rows).all(1)
        if bad.any():
            raise InputError(
                f"{int(bad.sum())} of {len(rows)} {what} have values that are not finite, "
                f"the first is row {int(bad.nonzero()[0])}; drop or replace them"
            )
    return rows


def normalise_embeddings(embeddings: Tensor | ArrayLike) -> Tensor:
    """Return [R, D] float32: every row scaled to unit norm; rows of norm zero stay zero.

    Args, raises: as ``float_rows``.
    """
    rows = float_rows(embeddings, "embeddings")
    # Twice: the square of a very small or large number may leave the range of float32.
    rows = rows / torch.clamp(rows.abs().amax(1, keepdim=True), min=torch.finfo(torch.float32).tiny)
    return torch.nn.functional.normalize(rows, dim=1)


def unit_rows(vectors: Tensor | ArrayLike, what: str = "embeddings", lengthen: bool = True) -> Tensor:
    """Return [R, D] float32 rows of unit norm; rows of norm zero stay zero, those of nearly unit norm as they are and,
    without ``lengthen``, those of a norm below 1, too."""
    rows = float_rows(vectors, what)
    excess = torch.linalg.vector_norm(rows, dim=1) - 1
    off = ~((excess.abs() if lengthen else excess) <= NEARLY_UNIT) & (rows != 0).any(1)
    if not off.any():
        return rows
    return torch.where(off[:, None], normalise_embeddings(rows), rows)


def query_vectors(
    vectors: Tensor | ArrayLike, dim: int, what: str = "queries", lengthen: bool = True
) -> Tensor:
    """Return one direction [D] or several [Q, D], of any norm but zero, as [Q, D] float32 of unit norm
    (``unit_rows``)."""
    try:
        given = torch.as_tensor(vectors)
    except (TypeError, ValueError, RuntimeError):
        raise InputError(
            f"{what} must be vectors [{dim}] or [count, {dim}], got {str(vectors)[:60]}"
        ) from None
    rows = given[None] if given.dim() == 1 else given
    if rows.dim() != 2 or rows.shape[1] != dim or not len(rows):
        raise InputError(f"{what} {list(given.shape)} must be [{dim}] or [count, {dim}]")
    directions = unit_rows(rows, what, lengthen)
    zero = ~directions.any(1)
    if zero.any():
        raise InputError(f"{what}: row {int(zero.nonzero()[0])} is zero, which has no direction")
    return directions
