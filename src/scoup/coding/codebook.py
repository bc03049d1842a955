"""The result of stage 1: a codebook and the codes learned with it."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from scoup.base.brief import brief
from scoup.base.errors import InputError
from scoup.coding.encode import encode
from scoup.coding.report import CodingReport, decoded_cosines
from scoup.scene.codes import SparseCodes
from scoup.scene.directions import normalise_embeddings


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
