"""The vote's kernel on a GPU; ``test_vote_triton.py`` interprets and compiles it without one."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch

from uplift import triton_checks
from uplift.random_votes import Sizes

if not torch.cuda.is_available():
    pytest.skip("needs a CUDA device", allow_module_level=True)


@pytest.mark.parametrize("seed", [0, 1, 2], ids="seed{}".format)
def test_votes_on_a_gpu(seed: int) -> None:
    for sizes, keep in (
        (Sizes(60_000, 9, 3, 128, 4, 500_000), 4),
        (Sizes(3000, 5, 3, 64, 4, 90_000), 4),
        (Sizes(700, 4, 2, 300, 16, 9000, without=1), 300),
        (Sizes(300, 3, 1, 4096, 4, 2000), 4),
        (Sizes(40, 3, 5, 7, 9, 5000), 7),
    ):
        triton_checks.check_vote(sizes, keep, seed, "cuda")


@pytest.mark.parametrize("check", triton_checks.SMALL_CHECKS)
def test_small_votes_on_a_gpu(check: Callable[[str], None]) -> None:
    check("cuda")
