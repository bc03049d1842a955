"""The exact coder, compiled and in torch: against brute force, optimality conditions, and each other."""

from __future__ import annotations

import itertools
import signal
import time
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import torch
from coders import Coder, clip_like, native_coder, problem
from torch import Tensor

from messages import refuses
from scoup.coding import native, reference
from scoup.coding.backends import RowCodes


def dense(coded: RowCodes, n_atoms: int) -> Tensor:
    """[n, L] float64 weights."""
    weights = torch.zeros(len(coded.support), n_atoms, dtype=torch.float64)
    return weights.scatter_add_(1, coded.support.clamp(min=0), coded.weights)


def best_of_all_supports(similarities: Tensor, gram: Tensor, k: int) -> Tensor:
    """[n] the greatest cosine over all supports of at most k atoms, by trying each."""
    best = torch.zeros(len(similarities), dtype=torch.float64)
    for size in range(1, k + 1):
        for support in itertools.combinations(range(len(gram)), size):
            chosen = list(support)
            toward, within = similarities[:, chosen].double(), gram[chosen][:, chosen].double()
            weights = torch.linalg.lstsq(within, toward.T).solution.T
            explained = (weights * toward).sum(1).clamp(min=0).sqrt()
            # A non-negative optimum has positive weights on some support, and is the solution without signs there.
            best = torch.where((weights >= 0).all(1), torch.maximum(best, explained), best)
    return best


def assert_valid(coded: RowCodes, similarities: Tensor, gram: Tensor, k: int) -> None:
    """Codes are well formed, and their weights optimal for the atoms used."""
    used = coded.support >= 0
    assert coded.support.shape == coded.weights.shape == (len(similarities), k)
    assert bool((coded.support < len(gram)).all())
    assert bool((used == (coded.weights > 0)).all())
    assert bool((coded.weights[:, :-1] >= coded.weights[:, 1:]).all())
    assert all(len(set(row)) == len(row) for row in (s[s >= 0].tolist() for s in coded.support))
    weights = dense(coded, len(gram))
    pull = similarities.double() - weights @ gram.double()
    scale = similarities.abs().amax().double().clamp(min=1e-30)
    assert bool(((pull / scale).abs()[weights > 0] <= 3e-5).all())
    explained = (weights * similarities.double()).sum(1).clamp(min=0).sqrt()
    torch.testing.assert_close(coded.cosines, explained, atol=1e-6, rtol=1e-5)


# Seeds of the problems are fixed; shares and gaps stand well clear of what either form reaches.
@pytest.mark.parametrize(("n_atoms", "k"), [(12, 2), (12, 4), (8, 3), (5, 4)])
def test_near_the_best_over_all_supports(coder: Coder, n_atoms: int, k: int) -> None:
    _, _, similarities, gram = problem(300, n_atoms)
    best = best_of_all_supports(similarities, gram, k)
    greedy = coder(similarities, gram, k)
    swapped = coder(similarities, gram, k, 2)
    for coded in (greedy, swapped):
        assert_valid(coded, similarities, gram, k)
        assert float((best - coded.cosines).min()) > -1e-5
    gap = best - swapped.cosines
    assert float(gap.mean()) < 1e-3
    assert float((gap < 1e-5).double().mean()) > 0.93
    assert float(gap.mean()) <= float((best - greedy.cosines).mean())


def test_weights_are_the_best_non_negative_ones_on_a_given_support(coder: Coder) -> None:
    # Unlike greedy supports, random ones often have negative least-squares weights.
    _, _, similarities, gram = problem(400, 9, dim=12)
    support = torch.rand(400, 9, generator=torch.Generator().manual_seed(0)).argsort(1)[:, :5]
    support[1::2, 2] = -1  # a slot that is not used
    coded = coder(similarities, gram, 5, 0, support)
    assert_valid(coded, similarities, gram, 5)
    assert float((coded.support >= 0).double().mean()) < 0.8, "no weight was at its bound: proves little"
    pull = (similarities.double() - dense(coded, 9) @ gram.double()).gather(1, support.clamp(min=0))
    assert (
        float(pull[support >= 0].max()) < 1e-5
    )  # the condition of Karush, Kuhn and Tucker for atoms at zero
    for row in range(0, 400, 40):
        chosen = support[row]
        best = best_of_all_supports(similarities[row : row + 1, chosen], gram[chosen][:, chosen], 5)
        assert float(coded.cosines[row]) == pytest.approx(float(best), abs=1e-5)


def assert_agree(core: ModuleType, similarities: Tensor, gram: Tensor, *more: Any) -> RowCodes:
    """Rounding may turn a choice between equals, and then the codes differ; hardly ever, and hardly."""
    ours, theirs = (coder(similarities, gram, *more) for coder in (native_coder(core), reference.code))
    assert_valid(ours, similarities, gram, more[0])
    mine, yours = (dense(each, len(gram)) for each in (ours, theirs))
    same = (mine > 0).eq(yours > 0).all(1)
    assert float(same.double().mean()) >= 0.98
    torch.testing.assert_close(mine[same], yours[same], atol=2e-4, rtol=0)
    torch.testing.assert_close(ours.cosines[same], theirs.cosines[same], atol=1e-5, rtol=0)
    torch.testing.assert_close(ours.cosines, theirs.cosines, atol=5e-3, rtol=0)
    return ours


@pytest.mark.parametrize(
    ("count", "n_atoms", "k", "dim"),
    [(50, 1, 1, 8), (40, 3, 8, 8), (500, 33, 1, 32), (300, 40, 4, 32), (200, 64, 16, 64), (20, 1024, 16, 64)],
)
@pytest.mark.parametrize("swap_passes", [0, 1, 2])
def test_compiled_and_torch_agree(
    core: ModuleType, count: int, n_atoms: int, k: int, dim: int, swap_passes: int
) -> None:
    _, _, similarities, gram = problem(count, n_atoms, dim, seed=3)
    assert_agree(core, similarities, gram, k, swap_passes)
    start = torch.rand(count, n_atoms, generator=torch.Generator().manual_seed(0)).argsort(1)[:, :k]
    start = torch.nn.functional.pad(start, (0, k - start.shape[1]), value=-1)
    ours = assert_agree(core, similarities, gram, k, swap_passes, start)
    if swap_passes and n_atoms > 5 * k:  # nearly every atom is swapped
        assert float((ours.support[:, :, None] == start[:, None, :]).double().mean()) < 0.5 / k


def test_copies_and_near_copies_of_an_atom_are_not_used_together(coder: Coder) -> None:
    rows, atoms, _, _ = problem(60, 6)
    generator = torch.Generator().manual_seed(0)
    plain = coder(rows @ atoms.T, atoms @ atoms.T, 4, 2)
    for noise in (0.0, 1e-4):
        alike = torch.cat([atoms, atoms + noise * torch.randn(atoms.shape, generator=generator)])
        similarities, gram = rows @ alike.T, alike @ alike.T
        found = coder(similarities, gram, 4, 2)
        torch.testing.assert_close(found.cosines, plain.cosines, atol=1e-5 if noise == 0 else 1e-3, rtol=0)
        for coded in (found, coder(similarities, gram, 4, 0, torch.tensor([0, 6, 2, 8]).expand(60, 4))):
            assert float(coded.weights.max()) < 2
            used = [[atom % 6 for atom in row if atom >= 0] for row in coded.support.tolist()]
            assert all(len(set(row)) == len(row) for row in used)


def test_swaps_and_warm_starts_never_lower_the_cosine(coder: Coder) -> None:
    _, _, similarities, gram = problem(300, 40)
    start = torch.rand(300, 40, generator=torch.Generator().manual_seed(1)).argsort(1)[:, :4]
    before = coder(similarities, gram, 4, 0, start).cosines
    for passes in (1, 2, 5):
        after = coder(similarities, gram, 4, passes, start).cosines
        assert bool((after >= before - 1e-7).all())
        before = after
    greedy = coder(similarities, gram, 4)
    again = coder(similarities, gram, 4, 0, greedy.support)
    torch.testing.assert_close(again.cosines, greedy.cosines)


def test_warm_supports_may_hold_gaps_and_repetitions(coder: Coder) -> None:
    _, _, similarities, gram = problem(10, 6)
    tidy = coder(similarities, gram, 4, 0, torch.tensor([[2, 5, -1, -1]] * 10))
    untidy = coder(similarities, gram, 4, 0, torch.tensor([[-1, 2, 2, 5]] * 10))
    assert untidy.support.equal(tidy.support)
    torch.testing.assert_close(untidy.weights, tidy.weights)
    empty = torch.full((10, 4), -1)
    assert not bool(coder(similarities, gram, 4, 0, empty).weights.any())
    assert bool((coder(similarities, gram, 4, 1, empty).cosines > 0).all())  # swaps fill unused slots


def test_rows_that_no_atom_helps(coder: Coder) -> None:
    _, _, similarities, gram = problem(3, 6)
    hopeless = torch.stack([torch.zeros(6), -similarities[0], torch.full((6,), -0.0)])
    for passes in (0, 1):
        coded = coder(hopeless, gram, 3, passes)
        assert coded.support.tolist() == [[-1] * 3] * 3
        assert not bool(coded.weights.any())
        assert not bool(coded.cosines.any())
    assert not bool(coder(torch.ones(2, 6), torch.zeros(6, 6), 3, 1).weights.any())  # atoms of norm zero


# From here on: the compiled core alone.


def test_a_row_is_coded_alike_alone_and_among_others(core: ModuleType) -> None:
    rows, atoms = clip_like(101, 50).numpy(), clip_like(37, 50, seed=1).numpy()
    together = core.code_rows(rows, atoms, 4, 1)
    for row in (0, 47, 48, 100):
        alone = core.code_rows(rows[row : row + 1].copy(), atoms, 4, 1)
        assert all(one[0].tobytes() == many[row].tobytes() for one, many in zip(alone, together, strict=True))


@pytest.mark.parametrize(("count", "dim", "n_others"), [(1, 1, 1), (5000, 37, 3), (53, 70, 33), (13, 5, 64)])
def test_products_moments_and_solutions(core: ModuleType, count: int, dim: int, n_others: int) -> None:
    random = np.random.default_rng(0)
    rows = random.standard_normal((count, dim), np.float32)
    others = random.standard_normal((n_others, dim), np.float32)
    np.testing.assert_allclose(core.row_products(rows, others), rows @ others.T, atol=1e-4)
    support = np.argsort(random.random((count, n_others)), 1)[:, :3].astype(np.int32)
    weights = random.random(support.shape, np.float32)
    weights[::2, -1], support[::2, -1] = 0, -1
    first, *codes = (torch.from_numpy(array) for array in (rows, support, weights, weights[:, 0].copy()))
    ours, theirs = (
        each.code_moments(first, RowCodes(*codes), codes[2], n_others) for each in (native, reference)
    )
    np.testing.assert_allclose(ours[0], theirs[0], rtol=2e-6, atol=1e-4)
    np.testing.assert_allclose(ours[1], theirs[1], rtol=2e-6, atol=1e-4)
    half = random.standard_normal((n_others, n_others))
    matrix, right = half @ half.T + np.eye(n_others), random.standard_normal((n_others, dim))
    np.testing.assert_allclose(core.solve_positive_definite(matrix, right), np.linalg.solve(matrix, right))


def test_long_sums_keep_their_precision(core: ModuleType) -> None:
    count = 50_000
    rows = np.full((count, 3), 0.1, np.float32)
    support, ones = np.zeros((count, 1), np.int32), np.ones((count, 1), np.float32)
    within, toward = core.code_moments(rows, support, ones, ones[:, 0].copy(), 1)
    assert within.item() == count
    np.testing.assert_allclose(toward, count * float(np.float32(0.1)), rtol=1e-5)


def f32(*shape: int) -> np.ndarray:
    return np.zeros(shape, np.float32)


def i32(*shape: int, value: int = 0) -> np.ndarray:
    return np.full(shape, value, np.int32)


FOUR = f32(4, 3)
# By function: good arguments, and wrong ones in their place.
HOSTILE: dict[str, tuple[tuple[Any, ...], list[dict[int, Any]]]] = {
    "code_rows": (
        (FOUR, f32(5, 3), 2, 1, None),
        [
            *({0: rows} for rows in (np.zeros((4, 3)), f32(3), f32(4, 6)[:, ::2], np.asfortranarray(FOUR))),
            *({1: atoms} for atoms in (f32(5, 2), i32(5, 3))),
            *({2: slots} for slots in (0, 65)),
            {3: -1},
            *({4: warm} for warm in (np.zeros((4, 2), np.int64), i32(3, 2), i32(4, 2, value=5))),
        ],
    ),
    "code_similarities": ((f32(4, 3), f32(3, 3), 1, 0, None), [{1: FOUR}]),
    "row_products": ((FOUR, FOUR), [{1: f32(4, 4)}]),
    "code_moments": (
        (FOUR, i32(4, 2), f32(4, 2), f32(4), 9),
        [{1: i32(4, 2, value=9)}, {1: i32(3, 2)}, {2: f32(4, 1)}, {3: f32(2)}, {4: -1}],
    ),
    "solve_positive_definite": (
        (np.eye(3), np.zeros((3, 2))), [{0: f32(3, 3)}, {0: np.zeros((3, 2))}, {0: -np.eye(3)}],
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_arrays_are_refused(core: ModuleType, name: str) -> None:
    (good, wrong), function = HOSTILE[name], getattr(core, name)
    function(*good)
    for changes in wrong:
        with refuses(ValueError):
            function(*(changes.get(place, argument) for place, argument in enumerate(good)))
    with pytest.raises(TypeError):
        function("rows", *good[1:])


def test_empty_arrays(core: ModuleType) -> None:
    none, some = f32(0, 3), np.ones((2, 3), np.float32)
    assert [array.shape for array in core.code_rows(none, some, 2, 1)] == [(0, 2), (0, 2), (0,)]
    for atoms in (none, 0 * some):
        assert core.code_rows(some, atoms, 2, 1)[0].tolist() == [[-1, -1]] * 2
    assert core.row_products(none, some).shape == (0, 2)
    assert core.row_products(some, none).shape == (2, 0)
    within, toward = core.code_moments(none, i32(0, 2), f32(0, 2), f32(0), 2)
    assert not within.any()
    assert toward.shape == (2, 3)


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="needs an interval timer")
def test_a_signal_interrupts_long_work(core: ModuleType) -> None:
    def raise_it(number: int, frame: object) -> None:
        raise TimeoutError

    rows, atoms = clip_like(60_000, 64).numpy(), clip_like(1024, 64, seed=1).numpy()
    before = signal.signal(signal.SIGALRM, raise_it)
    started = time.process_time()
    signal.setitimer(signal.ITIMER_REAL, 0.2)
    try:
        with pytest.raises(TimeoutError):
            core.code_rows(rows, atoms, 16, 1)  # seconds, left alone
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
    assert time.process_time() - started < 1.0
