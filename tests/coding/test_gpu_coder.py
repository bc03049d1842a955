"""The exact coder on a GPU; ``test_triton_coder.py`` interprets and compiles its kernel without one."""

from __future__ import annotations

import pytest
import torch
from coders import assert_as_good, assert_valid, clip_like, problem
from torch import Tensor

from scoup.coding.backends import RowCodes, coding_backend
from scoup.coding.encode import encode
from scoup.coding.exact import ExactSettings, solve_exact
from scoup.coding.reference import code

if not torch.cuda.is_available():
    pytest.skip("needs a CUDA device", allow_module_level=True)


@pytest.mark.parametrize(
    ("count", "n_atoms", "k", "dim"),
    [(1, 1, 1, 8), (5000, 64, 4, 64), (2000, 200, 4, 64), (500, 1000, 16, 64), (500, 100, 20, 64)],
)
@pytest.mark.parametrize("swap_passes", [0, 1, 2])
def test_rows_on_a_gpu_are_coded_as_well(
    count: int, n_atoms: int, k: int, dim: int, swap_passes: int
) -> None:
    rows, atoms, similarities, gram = problem(count, n_atoms, dim)
    there = rows.cuda(), atoms.cuda()
    first, again = (coding_backend(torch.device("cuda")).code_rows(*there, k, swap_passes) for _ in range(2))
    assert all(one.equal(other) for one, other in zip(first, again, strict=True))
    ours = RowCodes(first.support.cpu().long(), first.weights.cpu().double(), first.cosines.cpu().double())
    assert_valid(ours, similarities, gram, k)
    assert_as_good(ours, code(similarities, gram, k, swap_passes), n_atoms)


def test_a_gpu_finds_codebooks_as_good() -> None:
    rows = clip_like(6000, 128, objects=100)
    settings = ExactSettings(steps=100, passes=3)
    here, there, again = (solve_exact(r, 64, 4, 0, settings) for r in (rows, rows.cuda(), rows.cuda()))
    assert there.atoms.is_cuda
    assert there.codes.weights.is_cuda
    assert there.losses[-1] == pytest.approx(here.losses[-1], rel=0.02)
    for ours, theirs in ((there.atoms, again.atoms), (there.codes.weights, again.codes.weights)):
        assert ours.equal(theirs)
    assert there.losses == again.losses


def test_encode_does_not_care_for_the_precision_of_products() -> None:
    rows, atoms = clip_like(400).cuda(), clip_like(50, seed=1).cuda()

    def coded() -> tuple[Tensor, Tensor]:
        codes = encode(rows, atoms, 4)
        return codes.indices, codes.weights

    plain = coded()
    before = torch.get_float32_matmul_precision()
    torch.set_float32_matmul_precision("medium")
    try:
        rough = coded()
        assert torch.get_float32_matmul_precision() == "medium"
    finally:
        torch.set_float32_matmul_precision(before)
    assert all(one.equal(other) for one, other in zip(plain, rough, strict=True))
