"""Codes of rows under a fixed codebook: non-negative K-sparse least squares in Gram space."""

from __future__ import annotations

from torch import Tensor

from scoup.coding.backends import as_sparse_codes, coding_backend, working_device
from scoup.scene.codes import SparseCodes

SWAP_PASSES = 1


def encode(
    rows: Tensor,  # [R, D]
    atoms: Tensor,  # [L, D]
    k: int,
    backend: str | None = None,
) -> SparseCodes:
    """For each row at most K atoms and weights >= 0 that bring the decoded code near to it in angle.

    A greedy choice by orthogonal least squares and one round of exchanges, see ``reference.code``: near
    the optimum, and mostly it, but not guaranteed to be.

    Args:
        rows: [R, D] float32, unit norm or zero; rows of norm zero, and rows to which no atom
            has a positive inner product, get empty codes.
        atoms: [L, D] float32, any norm; atoms of norm zero are never used.
        k: most atoms a row may use; the codes have K columns even if there are fewer atoms.
        backend: by name; by default the fastest for the device of the rows.
    """
    device = working_device(rows)
    ours, codebook = (part.detach().to(device).float().contiguous() for part in (rows, atoms))
    codes = coding_backend(device, backend).code_rows(ours, codebook, min(k, len(atoms)), SWAP_PASSES)
    return as_sparse_codes(codes, len(atoms), k, rows.device)
