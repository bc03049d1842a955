"""Coding on a CPU: the C++ core in native/. Results do not depend on the number of threads, which is that of torch."""

from __future__ import annotations

import torch
from torch import Tensor

from scoup.base import required_core
from scoup.coding.backends import RowCodes


def code_rows(
    rows: Tensor, atoms: Tensor, k: int, swap_passes: int = 0, warm: Tensor | None = None
) -> RowCodes:
    """See ``CodingBackend.code_rows``."""
    start = None if warm is None else warm.numpy()
    arrays = rows.numpy(), atoms.numpy()
    with required_core() as core:
        coded = core.code_rows(*arrays, k, swap_passes, start, torch.get_num_threads())
    return RowCodes(*map(torch.from_numpy, coded))


def row_products(rows: Tensor, others: Tensor) -> Tensor:
    """See ``CodingBackend.row_products``."""
    with required_core() as core:
        return torch.from_numpy(core.row_products(rows.numpy(), others.numpy(), torch.get_num_threads()))


def code_moments(rows: Tensor, codes: RowCodes, scale: Tensor, n_atoms: int) -> tuple[Tensor, Tensor]:
    """See ``CodingBackend.code_moments``."""
    arrays = (tensor.numpy() for tensor in (rows, codes.support, codes.weights, scale))
    with required_core() as core:
        within, toward = core.code_moments(*arrays, n_atoms, torch.get_num_threads())
    return torch.from_numpy(within), torch.from_numpy(toward)


def solve(matrix: Tensor, right: Tensor) -> Tensor:
    """See ``CodingBackend.solve``."""
    with required_core() as core:
        solved = core.solve_positive_definite(matrix.numpy(), right.numpy(), torch.get_num_threads())
    return torch.from_numpy(solved)
