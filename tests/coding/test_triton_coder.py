"""The exact coder's kernel for GPUs: interpreted on the CPU, and compiled without a GPU."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from coders import Coder, assert_as_good, assert_valid, dense, problem

from compiling import compile_kernel
from scoup.coding.reference import code

MOST_STACK = 64  # bytes a thread: what spills from registers into memory


@pytest.mark.parametrize(
    ("count", "n_atoms", "k", "dim", "swap_passes", "seed"),
    [
        (19, 37, 4, 16, 1, 0),  # blocks of 4 rows, the last not full
        (24, 40, 4, 12, 2, 1),
        (24, 16, 3, 6, 3, 2),
        (24, 40, 5, 24, 0, 3),
        (20, 33, 1, 8, 1, 4),
        (12, 3, 8, 8, 1, 5),  # fewer atoms than slots
        (5, 1, 1, 4, 1, 6),
    ],
)
def test_agrees_with_the_reference(
    interpreted: Coder, count: int, n_atoms: int, k: int, dim: int, swap_passes: int, seed: int
) -> None:
    _, _, similarities, gram = problem(count, n_atoms, dim, seed)
    block_rows = None if seed == 0 else 32
    ours = interpreted(similarities, gram, k, swap_passes, block_rows=block_rows)
    assert_valid(ours, similarities, gram, k)
    assert_as_good(ours, code(similarities, gram, k, swap_passes), n_atoms)


@pytest.mark.parametrize("swap_passes", [0, 1])
def test_warm_supports(interpreted: Coder, swap_passes: int) -> None:
    # Unlike greedy supports, random ones often have negative least-squares weights.
    _, _, similarities, gram = problem(24, 9, dim=12)
    warm = torch.rand(24, 9, generator=torch.Generator().manual_seed(0)).argsort(1)[:, :5]
    warm[::3, 1] = -1
    warm[::4, 3] = warm[::4, 0]  # repeated
    ours = interpreted(similarities, gram, 5, swap_passes, warm, block_rows=32)
    theirs = code(similarities, gram, 5, swap_passes, warm)
    assert_valid(ours, similarities, gram, 5)
    assert_as_good(ours, theirs, 9)
    if swap_passes == 0:
        assert float((ours.support >= 0).double().mean()) < 0.9, "no weight was at its bound: proves little"
        pull = similarities.double() - dense(ours, 9) @ gram.double()
        held = pull.gather(1, warm.clamp(min=0))[warm >= 0]
        assert float(held.max()) < 1e-5  # the condition of Karush, Kuhn and Tucker for atoms at zero


def test_ugly_rows(interpreted: Coder) -> None:
    _, _, similarities, gram = problem(12, 10, dim=8)
    clean = interpreted(similarities, gram, 3, 2, block_rows=16)
    similarities[1] = torch.nan
    similarities[3] = 0
    similarities[5, 4] = torch.inf
    similarities[6] *= -1
    similarities[8] = -0.0
    coded = interpreted(similarities, gram, 3, 2, block_rows=16)
    others = [row for row in range(12) if row not in (1, 3, 5, 6, 8)]
    for ours, before in zip(coded, clean, strict=True):
        assert ours[others].equal(before[others])
        assert bool(ours.isfinite().all())
    assert coded.support[[1, 3, 8]].tolist() == [[-1] * 3] * 3
    assert not bool(coded.cosines[[1, 3, 8]].any())
    gram[2] = gram[:, 2] = torch.nan
    similarities[:, 2] = torch.nan
    coded = interpreted(similarities, gram, 3, 2, block_rows=16)
    assert bool(coded.weights.isfinite().all())
    assert not bool((coded.support == 2).any())


def test_copies_of_an_atom_are_used_once(interpreted: Coder) -> None:
    rows, atoms, _, _ = problem(16, 5)
    copies = atoms.repeat(3, 1)
    copies[7] = 0  # never used
    coded = interpreted(rows @ copies.T, copies @ copies.T, 4, 2, block_rows=16)
    plain = code(rows @ atoms.T, atoms @ atoms.T, 4, 2)
    torch.testing.assert_close(coded.cosines, plain.cosines, atol=1e-5, rtol=0)
    assert all(len({atom % 5 for atom in s[s >= 0].tolist()}) == int((s >= 0).sum()) for s in coded.support)
    assert not bool((coded.support == 7).any())


@pytest.mark.parametrize(
    ("n_atoms", "k", "warm"), [(1, 1, False), (64, 4, False), (256, 4, True), (1024, 16, False)]
)
@pytest.mark.parametrize("capability", [pytest.param(80, marks=pytest.mark.slow), 90])
def test_compiles_without_spilling(
    needs_triton: None, tmp_path: Path, capability: int, n_atoms: int, k: int, warm: bool
) -> None:
    from scoup.coding.triton import coder as gpu
    from scoup.coding.triton.kernels import code_kernel

    sizes = gpu.launch_sizes(n_atoms, k)
    constants = {
        "K": k,
        "PADDED_K": sizes.padded_k,
        "PADDED_ATOMS": sizes.padded_atoms,
        "BLOCK_ROWS": sizes.block_rows,
        "WARM": warm,
    }
    floats, integers = (
        ("similarities", "gram", "norms", "weights_out", "cosines_out"),
        ("warm", "support_out"),
    )
    types = {
        **dict.fromkeys(floats, "*fp32"),
        **dict.fromkeys(integers, "*i32"),
        **dict.fromkeys(("n_rows", "n_atoms", "swap_passes"), "i32"),
    }
    usage = compile_kernel(code_kernel, types, constants, sizes.warps, capability, tmp_path)
    assert usage.spilled <= MOST_STACK, usage
    assert usage.registers <= 255
