"""Products between regions, sparse weights and atoms: the part of the Adam solver that costs the time."""

from __future__ import annotations

import warnings

import numpy as np
import torch
from torch import Tensor

_BLOCK_ROWS = 1024  # rows of one pass of ``pull``: 2 MB of 512-dimensional embeddings


def products_for(rows: Tensor, n_atoms: int) -> SparseProducts | DenseProducts:
    """Sparse products on the CPU, where touching K of L atoms saves time; dense ones on other devices."""
    return SparseProducts(rows, n_atoms) if rows.device.type == "cpu" else DenseProducts(rows, n_atoms)


class DenseProducts:
    """Products over R unit rows F [R, D] and a support of K atoms a row, which changes only now and then, by dense
    matrix multiplication: L / K times the arithmetic, but no irregular access."""

    def __init__(self, rows: Tensor, n_atoms: int) -> None:
        self._rows = rows
        self._n_atoms = n_atoms
        self._indices = torch.empty(0, 0, dtype=torch.long)

    def set_support(self, indices: Tensor) -> None:
        """Set the atoms of each row, [K, R] int64, no atom twice in a row."""
        self._indices = indices
        self._pairs = _pairs(indices, self._n_atoms)

    def similarities(self, atoms: Tensor) -> Tensor:
        """[K, R]: the inner products of each row with the atoms of its support. ``atoms`` is [L, D]."""
        return (atoms @ self._rows.T).gather(0, self._indices)

    def gram_on_support(self, gram: Tensor) -> Tensor:
        """[K, K, R]: the entries of the Gram matrix [L, L] between the atoms of each row's support."""
        return _take(gram, self._pairs, self._indices)

    def pull(self, weights: Tensor) -> Tensor:
        """[L, D]: for each atom the sum of the rows that use it, weighted by ``weights`` [K, R]."""
        return self._dense(weights) @ self._rows

    def moments(self, weights: Tensor, scale: Tensor) -> Tensor:
        """[L, L]: the sum over rows of scale_r w_r w_r^T, from ``weights`` [K, R] and ``scale`` [R]."""
        dense = self._dense(weights)
        return (dense * scale) @ dense.T

    def _dense(self, weights: Tensor) -> Tensor:
        zeros = torch.zeros(self._n_atoms, weights.shape[1], dtype=weights.dtype, device=weights.device)
        return zeros.scatter_(0, self._indices, weights)


class SparseProducts:
    """The same products, which touch only the K atoms of each row (CPU)."""

    def __init__(self, rows: Tensor, n_atoms: int) -> None:
        self._rows = rows
        self._n_atoms = n_atoms

    def set_support(self, indices: Tensor) -> None:
        k, count = indices.shape
        self._indices = indices
        self._pairs = _pairs(indices, self._n_atoms)
        by_row = indices.T.contiguous().reshape(-1)
        starts = torch.arange(0, count * k + 1, k, dtype=torch.int32)
        self._pattern = _csr(starts, by_row.int(), self._rows.new_zeros(count * k), (count, self._n_atoms))
        self._by_atom, self._bag_starts = _bags(by_row, k, self._n_atoms)
        self._bag_rows = torch.div(self._by_atom, k, rounding_mode="floor").int()

    def similarities(self, atoms: Tensor) -> Tensor:
        k, count = self._indices.shape
        sampled = torch.sparse.sampled_addmm(self._pattern, self._rows, atoms.T, beta=0.0)
        return sampled.values().view(count, k).T.contiguous()

    def gram_on_support(self, gram: Tensor) -> Tensor:
        return _take(gram, self._pairs, self._indices)

    def pull(self, weights: Tensor) -> Tensor:
        bags = torch.nn.functional.embedding_bag(
            self._bag_rows,
            self._rows,
            self._bag_starts,
            per_sample_weights=weights.T.reshape(-1).index_select(0, self._by_atom),
            mode="sum",
        )
        return bags.view(-1, self._n_atoms, self._rows.shape[1]).sum(0)

    def moments(self, weights: Tensor, scale: Tensor) -> Tensor:
        values = (weights[:, None] * (weights * scale)[None]).reshape(-1)
        sums = torch.bincount(self._pairs, values, minlength=self._n_atoms**2)
        return sums.to(weights.dtype).view(self._n_atoms, self._n_atoms)


def _bags(by_row: Tensor, k: int, n_atoms: int) -> tuple[Tensor, Tensor]:
    """Entries of each (block of rows, atom) side by side, blocks outermost, so that a block stays in cache: [R * K]
    int64 positions in ``by_row``, and the int32 start of each of the (blocks x L) bags."""
    block = _BLOCK_ROWS * k
    n_blocks = -(-len(by_row) // block)
    # 16-bit keys let numpy sort by radix, twenty times faster than by comparison. The padding sorts last.
    keys = np.full(n_blocks * block, n_atoms - 1, dtype=np.uint16)
    keys[: len(by_row)] = by_row.numpy()
    order = np.argsort(keys.reshape(n_blocks, block), axis=1, kind="stable")
    order += np.arange(n_blocks)[:, None] * block
    position = torch.arange(len(by_row))
    bag = torch.div(position, block, rounding_mode="floor") * n_atoms + by_row
    sizes = torch.bincount(bag, minlength=n_blocks * n_atoms)
    return torch.from_numpy(order.reshape(-1)[: len(by_row)]), (sizes.cumsum(0) - sizes).int()


def _pairs(indices: Tensor, n_atoms: int) -> Tensor:
    """[K * K * R] positions in a flattened [L, L] matrix of all pairs of atoms in each row's support."""
    return (indices[:, None] * n_atoms + indices[None]).reshape(-1)


def _take(gram: Tensor, pairs: Tensor, indices: Tensor) -> Tensor:
    k, count = indices.shape
    return gram.reshape(-1).index_select(0, pairs).view(k, k, count)


def _csr(starts: Tensor, columns: Tensor, values: Tensor, shape: tuple[int, int]) -> Tensor:
    with warnings.catch_warnings():
        # torch calls its CSR tensors beta; the one operation used here is checked by our tests.
        warnings.filterwarnings("ignore", message="Sparse (CSR|invariant)", category=UserWarning)
        return torch.sparse_csr_tensor(starts, columns, values, size=shape, check_invariants=False)
