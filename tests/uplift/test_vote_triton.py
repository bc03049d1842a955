"""The vote's kernel: interpreted on the CPU, compiled without a GPU, and where there is one, run on it."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import torch

from compiling import compile_kernel
from interpreting import interpreter
from launches import launches
from scoup.base.errors import InputError
from uplift import triton_checks
from uplift.ballots import Sizes, random_ballot

on_a_gpu = pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")


@pytest.fixture(scope="module")
def interpreted(needs_triton: None) -> Iterator[Callable[..., None]]:
    """Runs a check of ``triton_checks`` with interpreted kernels."""
    with interpreter() as worker:
        yield lambda check, *arguments: worker.submit(check, *arguments, "cpu").result()


@pytest.mark.parametrize(
    ("sizes", "keep"),
    [
        (Sizes(12, 3, 3, 24, 4, 90), 4),
        (Sizes(20, 1, 1, 7, 2, 90, halves=True), 9),
        (Sizes(5, 4, 2, 300, 5, 40, halves=True, without=0), 12),
        (Sizes(3, 1, 1, 1, 1, 5), 1),
        (Sizes(4, 3, 2, 20, 3, 150), 20),
    ],
)
def test_agrees_with_the_reference(interpreted, sizes, keep):
    interpreted(triton_checks.check_vote, sizes, keep, 1)


def test_few_at_a_time(interpreted):
    interpreted(triton_checks.check_few_at_a_time)


def test_nothing_to_add(interpreted):
    interpreted(triton_checks.check_nothing_to_add)


def test_damaged_sums_are_refused(interpreted):
    interpreted(triton_checks.check_damage)


@pytest.mark.parametrize("capability", [80, 90])
def test_compiles(needs_triton: None, tmp_path: Path, capability: int) -> None:
    found = {name: launch for name, launch in launches().items() if name.startswith("vote")}
    assert len(found) > 2
    for name, launch in found.items():
        usage = compile_kernel(*launch, capability, tmp_path)
        assert usage.spilled == 0, (name, usage)
        assert usage.shared <= 48 << 10, (name, usage)


def test_votes_on_a_cpu_are_refused(needs_triton: None, monkeypatch: pytest.MonkeyPatch) -> None:
    from scoup.uplift.vote_backends.triton import Ballot

    monkeypatch.delenv("TRITON_INTERPRET", raising=False)
    with pytest.raises(InputError, match="these tensors are on cpu"):
        Ballot(**random_ballot(Sizes(), 0), device=torch.device("cpu"))


def test_without_triton_the_reason_is_told() -> None:
    program = (
        "import sys; sys.modules['triton'] = None; import torch, scoup; from scoup.base.errors import InputError; "
        "from scoup.uplift import vote_triton; import os; os.environ['TRITON_INTERPRET'] = '1'\n"
        "try: vote_triton.Ballot(0, [], [], torch.zeros(0), torch.device('cpu'))\n"
        "except InputError as error: print(error)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert "triton is not installed" in done.stdout


@on_a_gpu
@pytest.mark.parametrize("seed", [0, 1, 2], ids="seed{}".format)
def test_votes_on_a_gpu(seed: int) -> None:
    for sizes, keep in (
        (Sizes(60_000, 9, 3, 128, 4, 500_000), 4),
        (Sizes(3000, 5, 3, 64, 4, 90_000, halves=True), 4),
        (Sizes(700, 4, 2, 300, 16, 9000, without=1), 300),
        (Sizes(300, 3, 1, 4096, 4, 2000), 4),
        (Sizes(40, 3, 5, 7, 9, 5000), 7),
    ):
        triton_checks.check_vote(sizes, keep, seed, "cuda")


@on_a_gpu
def test_small_votes_on_a_gpu() -> None:
    triton_checks.check_few_at_a_time("cuda")
    triton_checks.check_nothing_to_add("cuda")
    triton_checks.check_damage("cuda")
