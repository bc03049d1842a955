"""The contract of the exact solver's backends, and their selection.

A backend is one module with the functions of ``CodingBackend``, chosen by name (``base.backends``). Regions are coded
on the CPU, whatever the device of the build: the same input gives the same codes everywhere.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol, cast

import torch
from torch import Tensor

from scoup.base import load_backend
from scoup.coding.arithmetic import ordered_sum
from scoup.scene import SparseCodes, index_dtype

BACKENDS = {"native": "scoup.coding.native", "reference": "scoup.coding.reference"}


class RowCodes(NamedTuple):
    """Codes of R rows. Weights are those of least squares: the norm of a decoded code is its cosine to the unit
    row it stands for. Backends give int32 and float32; ``reference.code`` keeps int64 and float64.
    """

    support: Tensor  # [R, K] integers by falling weight, -1 in slots that are not used
    weights: Tensor  # [R, K]
    cosines: Tensor  # [R]


class CodingBackend(Protocol):
    """The costly parts of the exact solver. All tensors are contiguous and on the CPU; float32 but for supports
    (int32) and the sums that a codebook is learned from (float64).
    """

    def code_rows(
        self, rows: Tensor, atoms: Tensor, k: int, swap_passes: int = 0, warm: Tensor | None = None
    ) -> RowCodes:
        """Codes of ``rows`` [R, D] over ``atoms`` [L, D], see ``reference.code``. Similarities exist only for a block
        of rows at a time.
        """
        ...

    def row_products(self, rows: Tensor, others: Tensor) -> Tensor:
        """[R, N]: ``rows`` [R, D] times the transposed ``others`` [N, D]."""
        ...

    def code_moments(
        self, rows: Tensor, codes: RowCodes, scale: Tensor, n_atoms: int
    ) -> tuple[Tensor, Tensor]:
        """The sums over rows f with weights w, each row counted ``scale`` [R] times: of w w^T [L, L] and of
        w f^T [L, D], both float64.
        """
        ...

    def solve(self, matrix: Tensor, right: Tensor) -> Tensor:
        """[L, D] float64: the X with ``matrix`` [L, L], positive definite, times X = ``right`` [L, D]."""
        ...


def coding_backend(name: str | None = None) -> CodingBackend:
    """The backend of that name, or by default the compiled core if there is one."""
    return cast(CodingBackend, load_backend(BACKENDS, torch.device("cpu"), name, "coding")[1])


def as_sparse_codes(codes: RowCodes, n_atoms: int, k: int, device: torch.device) -> SparseCodes:
    """The codes with weights that sum to 1, padded to k columns, on this device."""
    total = ordered_sum(codes.weights, 1)[:, None]
    weights = codes.weights / torch.where(total > 0, total, 1.0)
    missing = (0, k - weights.shape[1])
    indices = torch.nn.functional.pad(codes.support.clamp(min=0), missing)
    weights = torch.nn.functional.pad(weights, missing)
    return SparseCodes(indices.to(device, index_dtype(n_atoms)), weights.to(device), n_atoms)
