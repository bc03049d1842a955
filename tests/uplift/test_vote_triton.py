"""The vote's kernel: interpreted on the CPU, and compiled without a GPU."""

from __future__ import annotations

from pathlib import Path

import pytest

from compiling import compile_kernel
from launches import launches
from uplift import triton_checks
from uplift.random_votes import Sizes


@pytest.mark.parametrize(("sizes", "keep"), [
    (Sizes(12, 3, 3, 24, 4, 40), 4), (Sizes(20, 1, 1, 7, 2, 90), 9), (Sizes(5, 3, 2, 300, 5, 20, without=0), 12),
    (Sizes(3, 1, 1, 1, 1, 5), 1), (Sizes(4, 3, 2, 20, 3, 150), 20),
])  # fmt: skip
def test_agrees_with_the_reference(interpreted, sizes, keep):
    interpreted(triton_checks.check_vote, sizes, keep, 1)


@pytest.mark.parametrize("check", triton_checks.SMALL_CHECKS)
def test_small_checks(interpreted, check):
    interpreted(check)


@pytest.mark.parametrize("capability", [pytest.param(80, marks=pytest.mark.slow), 90])
def test_compiles(needs_triton: None, tmp_path: Path, capability: int) -> None:
    found = {name: launch for name, launch in launches().items() if name.startswith("vote")}
    assert len(found) > 2
    for name, launch in found.items():
        shared, unwritten = compile_kernel(*launch, capability, tmp_path)
        assert shared <= 48 << 10, name
        assert not unwritten, name
