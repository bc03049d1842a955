"""The result of stage 1: a codebook, the codes learned with it, and those of other rows under it."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from scoup.base import InputError, brief
from scoup.coding.backends import as_sparse_codes, coding_backend
from scoup.coding.report import CodingReport, decoded_cosines
from scoup.scene import SparseCodes, normalise_embeddings

SWAP_PASSES = 1


@dataclass(frozen=True, eq=False)
class Solution:
    """The result of a solver."""

    atoms: Tensor  # [L, D] float32
    codes: SparseCodes  # of the rows
    steps: int  # epochs, or steps and passes, that were run
    losses: tuple[float, ...]
    """Mean over all rows: of "adam" before each epoch; of "exact" before the passes, after each kept one, and at the
    end, never rising; () if nothing was learned."""


@dataclass(frozen=True, eq=False)
class Encoded:
    """Rows under a codebook that was not learned from them."""

    codes: SparseCodes
    """Of the rows, at most K atoms each."""
    cosines: Tensor
    """[R] float32 between each row and its decoded code; 0 for rows of norm zero or without a code."""
    badly_explained: Tensor
    """[R] boolean, the cosine is below that of rows like those the codebook was learned from; false for norm zero."""


@dataclass(frozen=True, eq=False)
class Codebook:
    """Atoms, and the codes of the rows they were learned from.

    Example:
        >>> embeddings = torch.randn(50, 16, generator=torch.Generator().manual_seed(0))
        >>> codebook = scoup.fit_codes(embeddings, n_atoms=8, k=2)
        >>> codebook.atoms.shape
        torch.Size([8, 16])
    """

    atoms: Tensor
    """[L, D] float32: of unit norm with the "exact" solver (or zero, where embeddings take fewer values than there are
    atoms), not with "adam"."""
    codes: SparseCodes
    """Of the rows passed to ``fit_codes``, in their order."""
    report: CodingReport
    """Quality and cost."""

    __repr__ = brief

    def encode(self, rows: Tensor) -> Encoded:
        """Code new rows [R, D] with these atoms, and mark the rows that the atoms explain badly.

        Raises:
            InputError: if the rows are not [R, D] with this codebook's D, or not finite.
        """
        rows = normalise_embeddings(rows)
        if rows.shape[1] != self.atoms.shape[1]:
            raise InputError(f"rows have {rows.shape[1]} dimensions, the codebook has {self.atoms.shape[1]}")
        rows = rows.to(self.atoms.device)
        return encode_rows(rows, self.atoms, self.codes.k, self.report.explained_from)


def encode_rows(rows: Tensor, atoms: Tensor, k: int, threshold: float) -> Encoded:
    """``Codebook.encode`` of unit rows [R, D]: ``threshold`` is the cosine below which a row is badly explained."""
    codes = encode(rows, atoms, k)
    cosines = decoded_cosines(rows, atoms, codes)
    return Encoded(codes, cosines, (cosines < threshold) & rows.any(1))


def encode(rows: Tensor, atoms: Tensor, k: int) -> SparseCodes:
    """Return for each row [R, D] at most K of the atoms [L, D] and weights >= 0 whose decoded code is near to it in
    angle.

    A greedy choice by orthogonal least squares and one round of exchanges, see ``reference.code``: near the optimum,
    and mostly it, but not guaranteed to be. Rows (unit norm or zero) of norm zero, and those to which no atom has a
    positive inner product, get empty codes; atoms of norm zero are never used. The codes have K columns even if there
    are fewer atoms.
    """
    ours, codebook = (tensor.detach().cpu().float().contiguous() for tensor in (rows, atoms))
    codes = coding_backend().code_rows(ours, codebook, min(k, len(atoms)), SWAP_PASSES)
    return as_sparse_codes(codes, len(atoms), k, rows.device)
