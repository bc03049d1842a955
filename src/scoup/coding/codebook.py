"""The result of stage 1: a codebook and the codes learned with it; and codes of rows it was not learned from."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from scoup.base.brief import brief
from scoup.base.errors import InputError
from scoup.coding.encode import encode
from scoup.coding.kmeans import spherical_kmeans
from scoup.coding.report import CodingReport, decoded_cosines
from scoup.scene.codes import SparseCodes, index_dtype
from scoup.scene.directions import normalise_embeddings

STARTS = 4  # of k-means for appended atoms; a single start often misses one of the new things
SAME_ATOM = 1e-6  # 1 - cosine


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
        return encode_rows(self._checked(rows), self.atoms, self.codes.k, self.report.explained_from)

    def _checked(self, rows: Tensor) -> Tensor:
        rows = normalise_embeddings(rows)
        if rows.shape[1] != self.atoms.shape[1]:
            raise InputError(f"rows have {rows.shape[1]} dimensions, the codebook has {self.atoms.shape[1]}")
        return rows.to(self.atoms.device)


def encode_rows(rows: Tensor, atoms: Tensor, k: int, threshold: float) -> Encoded:
    """``Codebook.encode`` of unit rows [R, D]: ``threshold`` is the cosine below which a row is badly explained."""
    codes = encode(rows, atoms, k)
    cosines = decoded_cosines(rows, atoms, codes)
    return Encoded(codes, cosines, (cosines < threshold) & rows.any(1))


def learn_atoms(rows: Tensor, atoms: Tensor, k: int, n_new: int, seed: int = 0) -> Tensor:
    """Return new atoms [M, D], unit vectors, no two the same, M <= n_new, for rows that the old ones explain badly.

    Spherical k-means, the best of ``STARTS`` starts by the loss of the rows under old and new atoms together. The new
    atoms reduce the loss of unseen things by three quarters; closed-form updates of them, with the old ones fixed,
    reduced the rest by 2 to 9 %: not worth a second solver.
    """
    count = min(n_new, len(rows))
    best, least = atoms.new_zeros(0, atoms.shape[1]), float("inf")
    if not count:
        return best
    for start in range(STARTS):
        found = _different(spherical_kmeans(rows, count, STARTS * seed + start))
        both = torch.cat([atoms, found])
        loss = float(1.0 - decoded_cosines(rows, both, encode(rows, both, k)).double().mean())
        if loss < least:
            best, least = found, loss
    return best


def check_new_atoms(n_atoms: int, n_new: int) -> None:
    """Refuse a negative number of new atoms, or one that makes a codebook too large."""
    if n_new < 0:
        raise InputError(f"the number of new atoms must not be negative, got {n_new}")
    index_dtype(n_atoms + n_new)  # checks its range


def _different(atoms: Tensor) -> Tensor:
    """Drop atoms that equal an earlier one: k-means of few distinct rows gives copies."""
    same = (atoms @ atoms.T) > 1 - SAME_ATOM
    return atoms[~same.tril(-1).any(1)]
