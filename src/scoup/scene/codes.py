"""Sparse codes: a few non-negative weights over the atoms of a codebook."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from scoup.base import InputError, brief, native_core


def index_dtype(n_atoms: int) -> torch.dtype:
    """Return the dtype of code indices: uint8 up to 256 atoms, uint16 beyond."""
    if not 1 <= n_atoms <= 65536:
        raise InputError(f"a codebook must have 1 to 65536 atoms, got {n_atoms}")
    return torch.uint8 if n_atoms <= 256 else torch.uint16


def signed(indices: Tensor) -> Tensor:
    """Return uint16 as a view of int16: torch neither sets rows of uint16 nor, before 2.10, selects them."""
    return indices.view(torch.int16) if indices.dtype == torch.uint16 else indices


def rows_of(indices: Tensor, chosen: Tensor | slice) -> Tensor:
    """Return ``indices[chosen]``, for all types of ``index_dtype``."""
    return signed(indices)[chosen].view(indices.dtype)


@dataclass(frozen=True, eq=False)
class SparseCodes:
    """R rows of at most K weighted atoms.

    Raises:
        InputError: a shape or dtype is wrong.

    Example:
        >>> atoms, weights = torch.tensor([[0, 2]], dtype=torch.uint8), torch.tensor([[0.75, 0.25]])
        >>> codes = scoup.SparseCodes(atoms, weights, n_atoms=3)
        >>> codes.to_dense().tolist()
        [[0.75, 0.0, 0.25]]
    """

    indices: Tensor
    """[R, K] uint8 (uint16 beyond 256 atoms), the atoms of each row."""
    weights: Tensor
    """[R, K] float32, not negative, largest first, summing to 1. An empty row has only zeros. Indices with weight zero
    have no meaning. Both may be given as numpy arrays."""
    n_atoms: int
    """L, the size of the codebook."""

    __repr__ = brief

    def __post_init__(self) -> None:
        for name in ("indices", "weights"):
            object.__setattr__(self, name, torch.as_tensor(getattr(self, name)))
        if self.indices.dim() != 2 or self.indices.shape != self.weights.shape:
            raise InputError(
                f"indices {list(self.indices.shape)} and weights {list(self.weights.shape)} must both be [R, K]"
            )
        if self.indices.dtype != index_dtype(self.n_atoms):
            raise InputError(f"indices are {self.indices.dtype}, expected {index_dtype(self.n_atoms)}")
        if self.weights.dtype != torch.float32:
            raise InputError(f"weights are {self.weights.dtype}, expected torch.float32")

    def __len__(self) -> int:
        return self.indices.shape[0]

    @property
    def k(self) -> int:
        return self.indices.shape[1]

    def to_dense(self) -> Tensor:
        """Return [R, L] float32."""
        dense = torch.zeros(len(self), self.n_atoms, device=self.weights.device)
        return dense.scatter_add_(1, self.indices.long(), self.weights)

    def to(self, device: torch.device | str) -> SparseCodes:
        return SparseCodes(self.indices.to(device), self.weights.to(device), self.n_atoms)

    def rows(self, chosen: Tensor | slice) -> SparseCodes:
        return SparseCodes(rows_of(self.indices, chosen), self.weights[chosen], self.n_atoms)

    @classmethod
    def from_dense(cls, dense: Tensor, k: int) -> SparseCodes:
        """Keep the k largest positive entries of each row of ``dense`` [R, L] and scale them to sum 1.

        This is the top-K step of the uplift (docs/method.md, stage 2). Rows without a positive entry stay empty. Of
        equal entries the lower index comes first, so that the result is the same everywhere.
        """
        n_atoms = dense.shape[1]
        keep = min(k, n_atoms)
        # A stable sort, not topk: topk promises no order among equal entries.
        values, order = torch.sort(dense, dim=1, descending=True, stable=True)
        weights = values[:, :keep].clamp(min=0).double()
        total = weights.sum(1, keepdim=True)
        weights = torch.where(total > 0, weights / total, 0.0).float()
        indices = torch.where(weights > 0, order[:, :keep], 0)
        if keep < k:
            weights = torch.nn.functional.pad(weights, (0, k - keep))
            indices = torch.nn.functional.pad(indices, (0, k - keep))
        return cls(indices.to(index_dtype(n_atoms)), weights.contiguous(), n_atoms)


def code_arrays(indices: Tensor, weights: Tensor) -> tuple[np.ndarray, np.ndarray]:
    """Return codes for the compiled core: indices as they are, weights as float32 or the bits of float16."""
    table = indices.detach().cpu().contiguous().numpy()
    if weights.dtype == torch.float16:
        return table, weights.detach().cpu().contiguous().numpy().view(np.uint16)
    return table, weights.detach().to("cpu", torch.float32).contiguous().numpy()


def float32_products(rows: Tensor, others: Tensor) -> Tensor:
    """Return [..., R, N]: ``rows`` [..., R, D] times the transposed ``others`` [..., N, D], with all bits of float32.

    That holds even if the user allows torch fewer bits on a GPU: similarities rounded to 10 bits of mantissa would
    select other atoms. On a GPU the products are float64; fields need only small ones.
    """
    if rows.device.type == "cpu":
        return rows @ others.transpose(-1, -2)
    return (rows.double() @ others.double().transpose(-1, -2)).float()


def stable_products(rows: Tensor, others: Tensor) -> Tensor:
    """Return [R, N] float32: ``rows`` [R, D] times the transposed ``others`` [N, D], the same for any number of
    threads.

    That needs the compiled core. Without it torch multiplies, whose results depend on the threads on some machines.
    """
    core = native_core() if rows.device.type == "cpu" else None
    if core is None:
        return float32_products(rows, others)
    arrays = (matrix.detach().float().contiguous().numpy() for matrix in (rows, others))
    return torch.from_numpy(core.row_products(*arrays, torch.get_num_threads()))


def check_atoms(indices: Tensor, n_atoms: int) -> None:
    """Refuse indices beyond the codebook, which would be read as atoms of another level once levels are flattened."""
    wide = indices.long()
    if wide.numel() and not 0 <= int(wide.min()) <= int(wide.max()) < n_atoms:
        raise InputError(f"code indices must be 0 to {n_atoms - 1}")
