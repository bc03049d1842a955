"""What the exact solver computes with, by the device of the rows: the compiled core, a Triton kernel, else torch."""

from __future__ import annotations

import functools
from types import ModuleType
from typing import NamedTuple, Protocol

import numpy as np
import torch
from torch import Tensor

from scoup.base.native import native_core
from scoup.coding import reference as exact_reference
from scoup.scene.codes import SparseCodes, full_products, index_dtype

_BLOCK_ROWS = 4096  # of the sums in torch


class RowCodes(NamedTuple):
    """Codes of R rows. Weights are those of least squares: the norm of a decoded code is its cosine to the unit
    row it stands for.
    """

    support: Tensor  # [R, K] int32 by falling weight, -1 in slots that are not used
    weights: Tensor  # [R, K] float32
    cosines: Tensor  # [R] float32


def as_sparse_codes(codes: RowCodes, n_atoms: int, k: int, device: torch.device) -> SparseCodes:
    """The codes with weights that sum to 1, padded to k columns, on this device."""
    total = ordered_sum(codes.weights, 1)[:, None]
    weights = codes.weights / torch.where(total > 0, total, 1.0)
    missing = (0, k - weights.shape[1])
    indices = torch.nn.functional.pad(codes.support.clamp(min=0), missing)
    weights = torch.nn.functional.pad(weights, missing)
    return SparseCodes(indices.to(device, index_dtype(n_atoms)), weights.to(device), n_atoms)


def ordered_sum(values: Tensor, dim: int) -> Tensor:
    """Sums along one axis, in an order that does not depend on the number of threads."""
    if values.device.type == "cpu":
        # On a CPU torch may cut a long sum into one part a thread.
        return torch.as_tensor(values.numpy().sum(dim))
    return values.sum(dim)


def square_root(values: Tensor) -> Tensor:
    """Square roots, on a CPU the nearest numbers: there torch's are one rounding off, by the build of torch."""
    if values.device.type == "cpu":
        return torch.from_numpy(np.sqrt(values.numpy()))
    return values.sqrt()


def take_rows(rows: Tensor, chosen: Tensor) -> Tensor:
    """[n, D]: some of the rows [R, D], by number [n]."""
    if rows.device.type == "cpu":
        # torch would start its threads for this, and on a busy machine they wait for each other longer than it takes.
        return torch.from_numpy(rows.numpy().take(chosen.numpy(), 0))
    return rows.index_select(0, chosen)


class Arithmetic(Protocol):
    """The costly parts of the exact solver. All tensors are contiguous and on one device; float32 but for supports
    (int32) and the sums that a codebook is learned from (float64). The same input gives the same bytes again.
    """

    def code_rows(
        self, rows: Tensor, atoms: Tensor, k: int, swap_passes: int, warm: Tensor | None = None
    ) -> RowCodes:
        """Codes of ``rows`` [R, D] over ``atoms`` [L, D], see ``exact_reference.code``; similarities exist only for
        a block of rows at a time.
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


def working_device(rows: Tensor) -> torch.device:
    """Where the exact coder works on these rows: where they are, but on the CPU for devices without float64."""
    return rows.device if rows.device.type in ("cpu", "cuda") else torch.device("cpu")


def arithmetic_at_hand(device: torch.device | str = "cpu") -> Arithmetic:
    """What is fastest on a CPU or CUDA device."""
    if torch.device(device).type != "cpu":
        return GpuArithmetic() if _has_triton() else TorchArithmetic()
    core = native_core()
    return TorchArithmetic() if core is None else NativeArithmetic(core)


@functools.cache
def _has_triton() -> bool:
    try:
        # Here and nowhere above: without a GPU nobody should wait for this import.
        from scoup.coding.triton import coder as gpu  # noqa: F401
    except ImportError:
        return False
    return True


class NativeArithmetic:
    """The compiled core, with as many threads as torch uses. Results do not depend on their number."""

    def __init__(self, core: ModuleType) -> None:
        self._core = core

    def code_rows(
        self, rows: Tensor, atoms: Tensor, k: int, swap_passes: int, warm: Tensor | None = None
    ) -> RowCodes:
        start = None if warm is None else warm.numpy()
        coded = self._core.code_rows(
            rows.numpy(), atoms.numpy(), k, swap_passes, start, torch.get_num_threads()
        )
        return RowCodes(*map(torch.from_numpy, coded))

    def row_products(self, rows: Tensor, others: Tensor) -> Tensor:
        products = self._core.row_products(rows.numpy(), others.numpy(), torch.get_num_threads())
        return torch.from_numpy(products)

    def code_moments(
        self, rows: Tensor, codes: RowCodes, scale: Tensor, n_atoms: int
    ) -> tuple[Tensor, Tensor]:
        support, weights, _ = codes
        arrays = (part.numpy() for part in (rows, support, weights, scale))
        within, toward = self._core.code_moments(*arrays, n_atoms, torch.get_num_threads())
        return torch.from_numpy(within), torch.from_numpy(toward)

    def solve(self, matrix: Tensor, right: Tensor) -> Tensor:
        solved = self._core.solve_positive_definite(matrix.numpy(), right.numpy(), torch.get_num_threads())
        return torch.from_numpy(solved)


class TorchArithmetic:
    """Plain torch on any device that has float64: slower, and on a CPU rounding may depend on the number of threads."""

    def code_rows(
        self, rows: Tensor, atoms: Tensor, k: int, swap_passes: int, warm: Tensor | None = None
    ) -> RowCodes:
        support, weights, cosines = exact_reference.code_rows(rows, atoms, k, swap_passes, warm)
        return RowCodes(support.int(), weights.float(), cosines.float())

    def row_products(self, rows: Tensor, others: Tensor) -> Tensor:
        return full_products(rows, others)

    def code_moments(
        self, rows: Tensor, codes: RowCodes, scale: Tensor, n_atoms: int
    ) -> tuple[Tensor, Tensor]:
        within = rows.new_zeros(n_atoms, n_atoms, dtype=torch.float64)
        toward = rows.new_zeros(n_atoms, rows.shape[1], dtype=torch.float64)
        for first in range(0, len(rows), _BLOCK_ROWS):
            part = slice(first, first + _BLOCK_ROWS)
            # One column more takes the slots that are not used. Nothing is added up here: on a GPU sums that
            # threads scatter come out in any order.
            support = codes.support[part].long()
            dense = rows.new_zeros(len(support), n_atoms + 1)
            dense.scatter_(1, support.where(support >= 0, n_atoms), codes.weights[part])
            dense = dense[:, :n_atoms]
            scaled = (dense * scale[part, None]).T
            within += full_products(scaled, dense.T)
            toward += full_products(scaled, rows[part].T)
        return within, toward

    def solve(self, matrix: Tensor, right: Tensor) -> Tensor:
        return torch.linalg.solve(matrix, right)


class GpuArithmetic(TorchArithmetic):
    """A Triton kernel codes rows; the rest is matrix products. The same bytes again on the same kind of GPU."""

    def code_rows(
        self, rows: Tensor, atoms: Tensor, k: int, swap_passes: int, warm: Tensor | None = None
    ) -> RowCodes:
        from scoup.coding.triton import coder as gpu

        if not gpu.can_code(len(atoms), k):
            return super().code_rows(rows, atoms, k, swap_passes, warm)
        return RowCodes(*gpu.code_rows(rows, atoms, k, swap_passes, warm))
