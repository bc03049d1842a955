"""What the exact solver computes with: the compiled core where it was built, else torch."""

from __future__ import annotations

from types import ModuleType
from typing import NamedTuple, Protocol

import numpy as np
import torch
from numpy.typing import NDArray

from scoup.codes import SparseCodes, index_dtype
from scoup.coding import exact_reference
from scoup.native import native_core

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]

_BLOCK_ROWS = 4096  # of the torch form


class RowCodes(NamedTuple):
    """Codes of R rows. Weights are those of least squares: the norm of a decoded code is its cosine to the unit
    row it stands for.
    """

    support: NDArray[np.int32]  # [R, K] by falling weight, -1 in slots that are not used
    weights: Floats  # [R, K]
    cosines: Floats  # [R]

    @classmethod
    def from_torch(cls, coded: exact_reference.Coded) -> RowCodes:
        support, weights, cosines = (part.cpu().numpy() for part in coded)
        return cls(support.astype(np.int32), weights.astype(np.float32), cosines.astype(np.float32))


def as_sparse_codes(codes: RowCodes, n_atoms: int, k: int, device: torch.device) -> SparseCodes:
    """The codes with weights that sum to 1, padded to k columns."""
    total = codes.weights.sum(1, keepdims=True)
    weights = codes.weights / np.where(total > 0, total, np.float32(1))
    missing = k - weights.shape[1]
    indices = torch.from_numpy(np.pad(np.maximum(codes.support, 0), ((0, 0), (0, missing))))
    weights = torch.from_numpy(np.pad(weights, ((0, 0), (0, missing))))
    return SparseCodes(indices.to(device, index_dtype(n_atoms)), weights.to(device), n_atoms)


class Arithmetic(Protocol):
    """The costly parts of the exact solver. All arrays are C-contiguous."""

    def code_rows(
        self, rows: Floats, atoms: Floats, k: int, swap_passes: int, warm: NDArray[np.int32] | None = None
    ) -> RowCodes:
        """Codes of ``rows`` [R, D] over ``atoms`` [L, D], see ``exact_reference.code``; similarities exist only for
        a block of rows at a time.
        """
        ...

    def row_products(self, rows: Floats, others: Floats) -> Floats:
        """[R, N]: ``rows`` [R, D] times the transposed ``others`` [N, D]."""
        ...

    def code_moments(
        self, rows: Floats, codes: RowCodes, scale: Floats, n_atoms: int
    ) -> tuple[Doubles, Doubles]:
        """The sums over rows f with weights w, each row counted ``scale`` [R] times: of w w^T [L, L] and of
        w f^T [L, D].
        """
        ...

    def solve(self, matrix: Doubles, right: Doubles) -> Doubles:
        """[L, D]: the X with ``matrix`` [L, L], positive definite, times X = ``right`` [L, D]."""
        ...


def arithmetic_at_hand() -> Arithmetic:
    """The compiled core, else torch."""
    core = native_core()
    return TorchArithmetic() if core is None else NativeArithmetic(core)


class NativeArithmetic:
    """The compiled core, with as many threads as torch uses. Results do not depend on their number."""

    def __init__(self, core: ModuleType) -> None:
        self._core = core

    def code_rows(
        self, rows: Floats, atoms: Floats, k: int, swap_passes: int, warm: NDArray[np.int32] | None = None
    ) -> RowCodes:
        return RowCodes(*self._core.code_rows(rows, atoms, k, swap_passes, warm, torch.get_num_threads()))

    def row_products(self, rows: Floats, others: Floats) -> Floats:
        return self._core.row_products(rows, others, torch.get_num_threads())

    def code_moments(
        self, rows: Floats, codes: RowCodes, scale: Floats, n_atoms: int
    ) -> tuple[Doubles, Doubles]:
        threads = torch.get_num_threads()
        return self._core.code_moments(rows, codes.support, codes.weights, scale, n_atoms, threads)

    def solve(self, matrix: Doubles, right: Doubles) -> Doubles:
        return self._core.solve_positive_definite(matrix, right, torch.get_num_threads())


class TorchArithmetic:
    """Plain torch: slower, and rounding may depend on the number of threads."""

    def code_rows(
        self, rows: Floats, atoms: Floats, k: int, swap_passes: int, warm: NDArray[np.int32] | None = None
    ) -> RowCodes:
        start = None if warm is None else torch.from_numpy(warm)
        codebook = torch.from_numpy(atoms)
        return RowCodes.from_torch(
            exact_reference.code_rows(torch.from_numpy(rows), codebook, k, swap_passes, start)
        )

    def row_products(self, rows: Floats, others: Floats) -> Floats:
        return (torch.from_numpy(rows) @ torch.from_numpy(others).T).numpy()

    def code_moments(
        self, rows: Floats, codes: RowCodes, scale: Floats, n_atoms: int
    ) -> tuple[Doubles, Doubles]:
        within = torch.zeros(n_atoms, n_atoms, dtype=torch.float64)
        toward = torch.zeros(n_atoms, rows.shape[1], dtype=torch.float64)
        for first in range(0, len(rows), _BLOCK_ROWS):
            part = slice(first, first + _BLOCK_ROWS)
            # Slots that are not used have weight 0, whatever their atom.
            support = torch.from_numpy(codes.support[part]).long().clamp_(min=0)
            dense = torch.zeros(len(support), n_atoms).scatter_add_(
                1, support, torch.from_numpy(codes.weights[part])
            )
            scaled = (dense * torch.from_numpy(scale[part])[:, None]).T
            within += scaled @ dense
            toward += scaled @ torch.from_numpy(rows[part])
        return within.numpy(), toward.numpy()

    def solve(self, matrix: Doubles, right: Doubles) -> Doubles:
        return torch.linalg.solve(torch.from_numpy(matrix), torch.from_numpy(right)).numpy()
