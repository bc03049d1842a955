"""The exact solver: the loss it reaches, degenerate rows, same bytes, and its gradient."""

from __future__ import annotations

import itertools
import sys
from dataclasses import replace
from types import ModuleType

import pytest
import torch
from coders import clip_like
from torch import Tensor

from children import finished
from scoup.coding import exact, fit_codes
from scoup.coding.adam import solve_adam
from scoup.coding.backends import coding_backend
from scoup.coding.codebook import Solution
from scoup.coding.exact import ExactSettings, Learner, solve_exact
from scoup.coding.reference import code
from scoup.coding.report import report_on
from support import threads_of_torch

REFERENCE = coding_backend("reference")
QUICK = ExactSettings(steps=30, batch=100, passes=3)


def test_ends_below_adam() -> None:
    rows = clip_like(300, 32, objects=40)
    adam = solve_adam(rows, 16, 3, epochs=500)
    adam_loss = report_on(rows, adam.atoms, adam.codes).loss
    efforts = exact.EFFORTS.items()
    losses = {name: solve_exact(rows, 16, 3, 0, each).losses[-1] for name, each in efforts}
    assert losses["best"] < losses["fast"] < adam_loss


def test_atoms_codes_and_losses_fit_together(backend: str) -> None:
    rows = clip_like(400, 24)
    seen: list[tuple[str, int, int]] = []
    solution = solve_exact(rows, 20, 4, 1, QUICK, lambda *call: seen.append(call), backend)
    torch.testing.assert_close(torch.linalg.vector_norm(solution.atoms, dim=1), torch.ones(20))
    report = report_on(rows, solution.atoms, solution.codes)
    assert report.loss == pytest.approx(solution.losses[-1], abs=1e-5)
    assert all(later <= earlier for earlier, later in itertools.pairwise(solution.losses))
    assert solution.steps == 33
    assert len(solution.losses) >= 3
    assert [done for _, done, _ in seen] == list(range(35))
    assert {(stage, total) for stage, _, total in seen} == {("sparse coding", 34)}
    weights = solution.codes.weights
    torch.testing.assert_close(weights.sum(1), torch.ones(400))
    assert bool((weights[:, :-1] >= weights[:, 1:]).all())


def test_passes_that_raise_the_loss_are_taken_back(backend: str, monkeypatch: pytest.MonkeyPatch) -> None:
    rows = clip_like(300, 16, objects=60)
    monkeypatch.setattr(exact, "OVERSTEP", 30.0)  # diverges
    wild = solve_exact(rows, 8, 2, 0, ExactSettings(steps=5, passes=6), backend=backend)
    assert all(later <= earlier for earlier, later in itertools.pairwise(wild.losses))
    assert wild.losses[7:] == (), "no pass was taken back: proves nothing"
    assert report_on(rows, wild.atoms, wild.codes).loss == pytest.approx(wild.losses[-1], abs=1e-5)


def test_the_gradient_is_that_of_the_loss() -> None:
    rows, atoms = clip_like(60, 10, objects=30), clip_like(7, 10, seed=1)

    def loss(codebook: Tensor) -> Tensor:
        codebook = codebook.double()
        return (1 - code(rows.double() @ codebook.T, codebook @ codebook.T, 3, 2).cosines).mean()

    learner = Learner(rows, 7, 3, 0, REFERENCE)
    learner.atoms = atoms
    gradient = learner.gradient(rows, learner.code(atoms, swap_passes=2)).double()
    direction = torch.randn(7, 10, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    step = 1e-6
    slope = (loss(atoms + step * direction) - loss(atoms - step * direction)) / (2 * step)
    assert float((gradient * direction).sum()) == pytest.approx(float(slope), rel=1e-3)


@pytest.mark.parametrize(("count", "distinct"), [(1, 1), (3, 3), (9, 9), (60, 1), (60, 2)])
def test_few_and_identical_rows(backend: str, count: int, distinct: int) -> None:
    rows = clip_like(distinct, 6, objects=4)[torch.arange(count) % distinct]
    solution = solve_exact(rows, 8, 3, 0, QUICK, backend=backend)
    assert solution.atoms.shape == (8, 6)
    assert bool(solution.atoms.isfinite().all())
    assert report_on(rows, solution.atoms, solution.codes).loss < 1e-3


@pytest.mark.parametrize(("n_atoms", "k"), [(1, 1), (1, 4), (5, 1), (3, 8), (40, 16), (300, 2)])
def test_sizes_of_codebook_and_code(backend: str, n_atoms: int, k: int) -> None:
    rows = clip_like(80, 20)
    solution = solve_exact(rows, n_atoms, k, 0, ExactSettings(steps=6, batch=32, passes=2), backend=backend)
    assert solution.atoms.shape == (n_atoms, 20)
    assert solution.codes.weights.shape == (80, k)
    torch.testing.assert_close(solution.codes.weights.sum(1), torch.ones(80))
    assert int(solution.codes.indices.long().max()) < n_atoms


def test_opposite_rows_may_stay_without_a_code(backend: str) -> None:
    rows = torch.cat([clip_like(40, 6), -clip_like(40, 6)])
    solution = solve_exact(rows, 1, 1, 0, QUICK, backend=backend)  # one atom cannot serve both
    assert set(solution.codes.weights[:, 0].tolist()) == {0.0, 1.0}
    assert solve_exact(rows, 4, 1, 0, QUICK, backend=backend).losses[-1] < 0.4


def test_rare_atoms_are_placed_at_badly_coded_rows() -> None:
    rows = clip_like(50, 8, objects=30)
    learner = Learner(rows, 4, 2, 0, REFERENCE)
    cosines = torch.linspace(1.0, 0.5, 50)
    placed = learner.reseed(torch.tensor([1, 3]), rows, cosines)
    assert placed.tolist() == [1, 3]
    assert learner.atoms[[1, 3]].equal(rows[[49, 48]])
    before = learner.atoms.clone()
    assert len(learner.reseed(torch.arange(4), rows, torch.ones(50))) == 0  # nothing to mend
    assert learner.atoms.equal(before)
    assert len(learner.reseed(torch.arange(4), rows[:2], cosines[-2:])) == 2  # fewer rows than atoms


def assert_same_bytes(one: Solution, other: Solution) -> None:
    assert one.atoms.equal(other.atoms)
    assert one.codes.indices.equal(other.codes.indices)
    assert one.codes.weights.equal(other.codes.weights)
    assert one.losses == other.losses


def test_same_seed_same_bytes(backend: str) -> None:
    rows = clip_like(300, 16)
    first, second, other = (solve_exact(rows, 12, 3, seed, QUICK, backend=backend) for seed in (5, 5, 6))
    assert_same_bytes(first, second)
    assert not first.atoms.equal(other.atoms)


def test_same_bytes_whatever_the_number_of_threads(core: ModuleType) -> None:
    rows = clip_like(5000, 200, objects=100)  # more than the sample of the start
    solutions, books = [], []
    for threads in (1, 2, 3):
        with threads_of_torch(threads):
            solutions.append(solve_exact(rows, 70, 4, 0, ExactSettings(steps=30, passes=2), backend="native"))
            books.append(fit_codes(rows, 20, 4, effort="fast", backend="native"))
    assert len({replace(book.report, seconds=0.0) for book in books}) == 1
    assert len({book.atoms.numpy().tobytes() for book in books}) == 1
    for solution in solutions[1:]:
        assert_same_bytes(solution, solutions[0])


@pytest.mark.parametrize(("solver", "epochs"), [("exact", 205), ("adam", 5)])
def test_zero_rows_get_empty_codes(solver: str, epochs: int) -> None:
    rows = clip_like(120, 16) * 3
    rows[[0, 50]] = 0
    book, kept = (fit_codes(each, 10, 3, solver, epochs=5, seed=2) for each in (rows, rows[rows.any(1)]))
    assert (book.report.solver, book.report.regions, book.report.epochs) == (solver, 118, epochs)
    torch.testing.assert_close(book.codes.weights.sum(1), rows.any(1).float())
    assert kept.atoms.equal(book.atoms)


STEPS = """
import os, torch
from scoup.coding.backends import coding_backend
from scoup.coding.exact import FAST, Learner
torch.set_num_threads(1)
rows = torch.nn.functional.normalize(torch.randn(200, 512), dim=1)
learner = Learner(rows, 128, 4, 0, coding_backend("native"))
steps = learner.steps(FAST)
next(steps)
torch.set_num_threads(2)
before = len(os.listdir("/proc/self/task"))
for _ in zip(range(20), steps):
    pass
print(len(os.listdir("/proc/self/task")) - before)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="counts threads in /proc")
def test_steps_start_no_threads_of_torch(preloaded_python: str) -> None:
    """Beside other work those wait for each other at every operation (but every 25th step may)."""
    ended = finished([preloaded_python, "-c", STEPS], check=True)
    assert ended.stdout.strip() == "0"
