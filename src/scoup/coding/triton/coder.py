"""Coding on a GPU: a Triton kernel codes rows; the rest is matrix products of torch.

Imports triton: import this module only where rows are on a GPU. The same bytes again on the same kind of GPU.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
import triton
from torch import Tensor

from scoup.coding import reference
from scoup.coding.backends import RowCodes
from scoup.coding.reference import code_moments as code_moments
from scoup.coding.reference import row_products as row_products
from scoup.coding.reference import solve as solve
from scoup.coding.triton.kernels import code_kernel

MOST_ATOMS, MOST_SLOTS = 1024, 16  # what one program's registers hold
_NUMBERS_A_THREAD = 32  # of the largest tensor, [BLOCK_ROWS, K, L]
_MOST_WARPS = 8
_MOST_BLOCK_ROWS = 8  # rows of a block wait for each other
_CALL_NUMBERS = 1 << 26  # similarities that exist at a time


@dataclass(frozen=True)
class Launch:
    """Sizes of one program."""

    padded_k: int  # K as a power of two
    padded_atoms: int  # L as a power of two
    block_rows: int  # rows it codes, a power of two
    warps: int  # of 32 threads


def can_code(n_atoms: int, k: int) -> bool:
    """Return whether a codebook and code of these sizes fit into one program."""
    return 1 <= n_atoms <= MOST_ATOMS and 1 <= k <= MOST_SLOTS


def launch_sizes(n_atoms: int, k: int) -> Launch:
    """Return the sizes of programs. One warp wherever that is enough: then no sum crosses warps."""
    # Triton 3.6 fails to compile the kernel for tensors of one atom.
    padded_k, padded_atoms = triton.next_power_of_2(k), max(2, triton.next_power_of_2(n_atoms))
    numbers = padded_k * padded_atoms  # of one row
    of_a_warp = 32 * _NUMBERS_A_THREAD
    warps = min(_MOST_WARPS, max(1, numbers // of_a_warp))
    block_rows = min(_MOST_BLOCK_ROWS, max(1, of_a_warp // numbers))
    return Launch(padded_k, padded_atoms, block_rows, warps)


def code(
    similarities: Tensor,  # [n, L]
    gram: Tensor,  # [L, L]
    k: int,
    swap_passes: int = 0,
    warm: Tensor | None = None,  # [n, K]
    sizes: Launch | None = None,
) -> RowCodes:
    """``reference.code`` in float32, all tensors on one GPU: support [n, K] int32, weights [n, K] and cosines
    [n] float32. L and K as ``can_code`` allows. Similarities that are not finite count as 0.
    """
    sizes = sizes or launch_sizes(similarities.shape[1], k)
    n_rows, n_atoms = similarities.shape
    similarities, gram = similarities.contiguous(), gram.contiguous()
    device = similarities.device
    support = torch.empty(n_rows, k, dtype=torch.int32, device=device)
    weights = torch.empty(n_rows, k, dtype=torch.float32, device=device)
    cosines = torch.empty(n_rows, dtype=torch.float32, device=device)
    if n_rows == 0:
        return RowCodes(support, weights, cosines)
    code_kernel[(triton.cdiv(n_rows, sizes.block_rows),)](
        similarities,
        gram,
        gram.diagonal().contiguous(),
        support if warm is None else warm.to(torch.int32).contiguous(),
        support,
        weights,
        cosines,
        n_rows,
        n_atoms,
        swap_passes,
        K=k,
        PADDED_K=sizes.padded_k,
        PADDED_ATOMS=sizes.padded_atoms,
        BLOCK_ROWS=sizes.block_rows,
        WARM=warm is not None,
        num_warps=sizes.warps,  # pyright: ignore[reportCallIssue]  taken by the launcher
        # Nothing here relies on a product being rounded before it is added.
        enable_fp_fusion=True,  # pyright: ignore[reportCallIssue]
    )
    return RowCodes(support, weights, cosines)


def code_rows(
    rows: Tensor,  # [R, D]
    atoms: Tensor,  # [L, D]
    k: int,
    swap_passes: int = 0,
    warm: Tensor | None = None,  # [R, K]
) -> RowCodes:
    """See ``CodingBackend.code_rows``; what does not fit into one program is coded as by ``reference``."""
    if not can_code(len(atoms), k):
        return reference.code_rows(rows, atoms, k, swap_passes, warm)

    def coder(similarities: Tensor, gram: Tensor, start: Tensor | None) -> RowCodes:
        # A kernel is launched on the current device, whichever the tensors are on.
        with torch.cuda.device_of(similarities):
            return code(similarities, gram, k, swap_passes, start)

    return reference.code_in_blocks(coder, rows, atoms, _CALL_NUMBERS // len(atoms), warm)
