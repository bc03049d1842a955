"""The result of stage 1: a codebook and the codes learned with it."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from scoup.codes import SparseCodes
from scoup.coding.encode import encode
from scoup.coding.report import CodingReport
from scoup.coding.rows import unit_rows
from scoup.errors import InputError


@dataclass(frozen=True, eq=False)
class Codebook:
    """Atoms, and the codes of the rows they were learned from.

    Attributes:
        atoms: [L, D] float32, as learned: of unit norm with the "exact" solver, not with "adam".
        codes: of the rows given to ``fit_codes``, in their order.
        report: quality and cost.
    """

    atoms: Tensor  # [L, D]
    codes: SparseCodes
    report: CodingReport

    def encode(self, rows: Tensor) -> SparseCodes:
        """Codes of new rows [R, D] with these atoms, at most K atoms each; see ``scoup.coding.encode``.

        Raises:
            InputError: if the rows are not [R, D] with this codebook's D, or not finite.
        """
        rows = unit_rows(rows)
        if rows.shape[1] != self.atoms.shape[1]:
            raise InputError(f"rows have {rows.shape[1]} dimensions, the codebook has {self.atoms.shape[1]}")
        return encode(rows.to(self.atoms.device), self.atoms, self.codes.k)
