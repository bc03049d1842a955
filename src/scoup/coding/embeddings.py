"""Embeddings before they are coded: checked, and brought to unit norm."""

from __future__ import annotations

import torch
from torch import Tensor

from scoup.base.errors import InputError


def normalise_embeddings(embeddings: Tensor) -> Tensor:
    """[R, D] float32: the rows scaled to unit norm; rows of norm zero stay zero.

    Raises:
        InputError: if ``embeddings`` is not a floating-point [R, D] tensor, or not finite.
    """
    if embeddings.dim() != 2 or embeddings.shape[1] == 0:
        raise InputError(f"embeddings must be [R, D], got {list(embeddings.shape)}")
    if not embeddings.is_floating_point():
        raise InputError(f"embeddings must be floating-point numbers, got {embeddings.dtype}")
    bad = ~torch.isfinite(embeddings).all(1)
    if bad.any():
        raise InputError(
            f"{int(bad.sum())} of {len(embeddings)} embeddings hold values that are not finite, "
            f"the first is row {int(bad.nonzero()[0])}; drop or replace them"
        )
    rows = embeddings.detach().float()
    # Twice: the square of a very small or large number may leave the range of float32.
    rows = rows / torch.clamp(rows.abs().amax(1, keepdim=True), min=torch.finfo(torch.float32).tiny)
    return torch.nn.functional.normalize(rows, dim=1)
