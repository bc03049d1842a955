"""Codes of rows under a fixed codebook: non-negative K-sparse least squares in Gram space."""

from __future__ import annotations

from torch import Tensor

from scoup.coding.backends import as_sparse_codes, coding_backend
from scoup.scene.codes import SparseCodes

SWAP_PASSES = 1


def encode(
    rows: Tensor,  # [R, D]
    atoms: Tensor,  # [L, D]
    k: int,
    backend: str | None = None,
) -> SparseCodes:
    """Return for each row at most K atoms and weights >= 0 whose decoded code is near to it in angle.

    A greedy choice by orthogonal least squares and one round of exchanges, see ``reference.code``: near the optimum,
    and mostly it, but not guaranteed to be. Rows (unit norm or zero) of norm zero, and those to which no atom has a
    positive inner product, get empty codes; atoms of norm zero are never used. The codes have K columns even if there
    are fewer atoms.
    """
    ours, codebook = (part.detach().cpu().float().contiguous() for part in (rows, atoms))
    codes = coding_backend(backend).code_rows(ours, codebook, min(k, len(atoms)), SWAP_PASSES)
    return as_sparse_codes(codes, len(atoms), k, rows.device)
