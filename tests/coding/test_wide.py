"""Wide codes: the compiled core against torch, and both against the conditions of non-negative least squares."""

from __future__ import annotations

import platform
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import torch
from coders import clip_like, problem
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.optimize import nnls
from torch import Tensor

from scoup.base.errors import InputError
from scoup.base.native import native_core
from scoup.coding import fit_codes, wide
from scoup.coding.wide import SWEEPS, TOLERANCE, plain_weights, wide_codes
from scoup.uplift.build_settings import BuildSettings
from scoup.uplift.region_codes import learn_codebook
from support import examples

MANY_SWEEPS = 20_000
X86 = ("x86_64", "AMD64")


@pytest.fixture(params=["plain", "native"])
def form(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """The test holds for wide codes made by torch alone, and by the compiled core."""
    if request.param == "native":
        request.getfixturevalue("core")
    else:
        monkeypatch.setattr(wide, "native_core", lambda: None)


@contextmanager
def threads(count: int) -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def of_core(
    core: ModuleType,
    similarities: Tensor,
    gram: Tensor,
    sweeps: int = SWEEPS,
    tolerance: float = TOLERANCE,
    n_threads: int = 1,
) -> Tensor:
    arrays = similarities.contiguous().numpy(), gram.contiguous().numpy()
    return torch.from_numpy(core.wide_weights(*arrays, sweeps, tolerance, n_threads))


@settings(max_examples=examples(60), deadline=None)
@given(
    seed=st.integers(0, 10**6), count=st.integers(0, 40), n_atoms=st.integers(1, 40), dim=st.integers(1, 24),
    sweeps=st.integers(0, 40), tolerance=st.sampled_from([0.0, 1e-3, 0.1]),
)  # fmt: skip
@example(seed=0, count=17, n_atoms=1, dim=1, sweeps=30, tolerance=1e-3)
def test_core_and_torch_agree(
    seed: int, count: int, n_atoms: int, dim: int, sweeps: int, tolerance: float
) -> None:
    core = native_core()
    if core is None:
        pytest.skip("the compiled core is not built")
    generator = torch.Generator().manual_seed(seed)
    rows, atoms = torch.randn(count, dim, generator=generator), torch.randn(n_atoms, dim, generator=generator)
    atoms[torch.rand(n_atoms, generator=generator) < 0.1] = 0
    similarities, gram = rows @ atoms.T, atoms @ atoms.T
    ours = of_core(core, similarities, gram, sweeps, tolerance)
    theirs = plain_weights(similarities, gram, sweeps, tolerance)
    if platform.machine() not in X86:  # compilers may join a product and a sum there
        torch.testing.assert_close(ours, theirs, atol=1e-5, rtol=1e-5)
    else:
        assert torch.equal(ours, theirs)


@pytest.mark.parametrize("n_threads", [2, 3, 16])
def test_the_number_of_threads_does_not_matter(core: ModuleType, n_threads: int) -> None:
    _, _, similarities, gram = problem(1000, 40)
    alone = of_core(core, similarities, gram)
    assert torch.equal(of_core(core, similarities, gram, n_threads=n_threads), alone)


@pytest.mark.usefixtures("form")
def test_codes_do_not_depend_on_the_threads_of_torch() -> None:
    rows, atoms, _, _ = problem(1000, 40)
    with threads(1):
        alone = wide_codes(rows, atoms, 8)
    with threads(2):
        both = wide_codes(rows, atoms, 8)
    assert torch.equal(both.indices, alone.indices)
    assert torch.equal(both.weights, alone.weights)


@settings(max_examples=examples(40), deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 30), st.integers(2, 40))
def test_converged_weights_are_optimal(seed: int, n_atoms: int, dim: int) -> None:
    """The conditions of Karush, Kuhn and Tucker."""
    rows = clip_like(20, dim, 6, seed)
    atoms = clip_like(n_atoms, dim, 6, seed + 1)
    similarities, gram = rows @ atoms.T, atoms @ atoms.T
    weights = plain_weights(similarities, gram, MANY_SWEEPS, 1e-6)
    assert bool((weights >= 0).all())
    pull = similarities.double() - weights.double() @ gram.double()
    # A last sweep of steps below the tolerance moves no pull further than their sum; the rest is rounding.
    most = 1e-6 * n_atoms + 1e-4
    assert float(pull.max()) < most
    used = pull[weights > 0]
    assert not len(used) or float(used.abs().max()) < most


def test_converged_weights_are_those_of_scipy() -> None:
    rows, atoms, similarities, gram = problem(60, 20, dim=32)
    weights = plain_weights(similarities, gram, MANY_SWEEPS, 0.0)
    for row, found in zip(rows, weights, strict=True):
        expected, _ = nnls(atoms.T.double().numpy(), row.double().numpy())
        torch.testing.assert_close(found, torch.from_numpy(expected).float(), atol=1e-3, rtol=0)


def test_the_usual_sweeps_come_near(form: None) -> None:
    rows, atoms, similarities, gram = problem(200, 64, dim=128)
    found = wide_codes(rows, atoms, 64).to_dense()
    best = plain_weights(similarities, gram, MANY_SWEEPS, 0.0)

    def loss(weights: Tensor) -> Tensor:
        return (rows - weights @ atoms).square().sum(1)

    assert float((loss(found) - loss(best)).max()) < 1e-2
    assert float((loss(found) - loss(best)).mean()) < 1e-3


@pytest.mark.usefixtures("form")
@pytest.mark.parametrize("k", [1, 3, 8, 40])
def test_the_atoms_of_the_largest_weights_are_solved_for_again(k: int) -> None:
    """The atoms are those of the whole solution; their weights are the best that these atoms have alone."""
    rows, atoms, similarities, gram = problem(100, 40)
    codes = wide_codes(rows, atoms, k)
    assert codes.indices.shape == codes.weights.shape == (100, k)
    assert codes.n_atoms == 40
    assert bool((codes.weights >= 0).all())
    assert bool((codes.weights[:, 1:] <= codes.weights[:, :-1]).all())
    assert not codes.indices[codes.weights == 0].any()
    whole, found = plain_weights(similarities, gram), codes.to_dense()
    for row, weights, code in zip(rows, whole, found, strict=True):
        largest = weights.argsort(descending=True, stable=True)[:k]
        largest = largest[weights[largest] > 0]
        best, _ = nnls(atoms[largest].T.double().numpy(), row.double().numpy())
        expected = torch.zeros(40)
        expected[largest] = torch.from_numpy(best).float()
        torch.testing.assert_close(code, expected, atol=1e-3, rtol=0)
        other, ours = (float((row - each @ atoms).square().sum()) for each in (expected, code))
        assert ours == pytest.approx(other, abs=1e-5)


@pytest.mark.usefixtures("form")
def test_rows_of_zero_get_empty_codes_and_change_no_other() -> None:
    rows, atoms, _, _ = problem(50, 12)
    expected = wide_codes(rows, atoms, 4)
    with_zeros = rows.clone()
    with_zeros[[0, 17, 49]] = 0
    found = wide_codes(with_zeros, atoms, 4)
    empty = ~with_zeros.any(1)
    assert not found.weights[empty].any()
    assert not found.indices[empty].any()
    assert torch.equal(found.weights[~empty], expected.weights[~empty])
    assert torch.equal(found.indices[~empty], expected.indices[~empty])


@pytest.mark.usefixtures("form")
def test_atoms_of_zero_are_never_used() -> None:
    rows, atoms, _, _ = problem(80, 12)
    padded = torch.zeros(20, atoms.shape[1])
    places = torch.tensor([0, 2, 3, 5, 6, 8, 9, 11, 12, 14, 15, 18])
    padded[places] = atoms
    alone, among = wide_codes(rows, atoms, 6), wide_codes(rows, padded, 6)
    used = alone.weights > 0
    assert torch.equal(among.weights > 0, used)
    assert torch.equal(among.indices[used].long(), places[alone.indices[used].long()])
    torch.testing.assert_close(among.weights, alone.weights, atol=1e-5, rtol=0)
    nothing = wide_codes(rows, torch.zeros(5, atoms.shape[1]), 3)
    assert not nothing.weights.any()


@pytest.mark.usefixtures("form")
def test_fewer_atoms_than_places() -> None:
    rows, atoms, _, _ = problem(30, 3)
    codes = wide_codes(rows, atoms, 8)
    assert codes.indices.shape == codes.weights.shape == (30, 8)
    assert not codes.weights[:, 3:].any()
    assert not codes.indices[:, 3:].any()
    assert torch.equal(codes.weights[:, :3], wide_codes(rows, atoms, 3).weights)


@pytest.mark.usefixtures("form")
def test_one_atom_takes_what_a_row_has_of_it() -> None:
    rows = torch.nn.functional.normalize(
        torch.randn(30, 8, generator=torch.Generator().manual_seed(0)), dim=1
    )
    atom = 2 * rows[:1]  # any norm
    codes = wide_codes(rows, atom, 4)
    torch.testing.assert_close(codes.weights[:, 0], (rows @ rows[0] / 2).clamp(min=0), atol=1e-6, rtol=0)
    assert not codes.weights[:, 1:].any()


@pytest.mark.usefixtures("form")
def test_no_rows() -> None:
    codes = wide_codes(torch.zeros(0, 8), torch.eye(8), 4)
    assert codes.indices.shape == codes.weights.shape == (0, 4)


@pytest.mark.usefixtures("form")
def test_of_equal_atoms_the_first_is_taken() -> None:
    atoms = torch.eye(8)[[2, 0, 2, 1, 0, 2]]  # three things under six numbers
    rows = torch.eye(8)[[0, 1, 2]]
    codes = wide_codes(rows, atoms, 3)
    assert codes.indices[:, 0].tolist() == [1, 3, 0]
    assert codes.weights.tolist() == [[1, 0, 0]] * 3


@pytest.mark.usefixtures("form")
def test_of_equal_weights_the_first_atoms_are_kept() -> None:
    row = torch.full((1, 9), 1 / 3)
    codes = wide_codes(row, torch.eye(9), 4)
    assert codes.indices.tolist() == [[0, 1, 2, 3]]
    assert len(set(codes.weights[0].tolist())) == 1


@pytest.mark.usefixtures("form")
def test_more_than_256_atoms() -> None:
    rows = clip_like(40, 64)
    codes = wide_codes(rows, clip_like(300, 64, seed=2), 8)
    assert codes.indices.dtype == torch.uint16
    assert int(codes.indices.long().max()) >= 256


@pytest.mark.usefixtures("form")
@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_embeddings_that_are_not_numbers_do_not_come_so_far(bad: float) -> None:
    rows = clip_like(20, 16)
    rows[3, 5] = bad
    with pytest.raises(InputError, match="finite"):
        learn_codebook(rows, BuildSettings(n_atoms=8))


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), -float("inf"), 3e38])
@pytest.mark.parametrize("what", ["similarities", "gram", "diagonal", "both"])
def test_the_core_bears_what_is_not_a_number(core: ModuleType, bad: float, what: str) -> None:
    _, _, similarities, gram = problem(40, 12)
    expected = of_core(core, similarities, gram)
    if what in ("similarities", "both"):
        similarities[3, 5] = bad
        similarities[7] = bad
    if what in ("gram", "both"):
        gram[2, 4] = bad
    if what == "diagonal":
        gram[2, 2] = bad
    found = of_core(core, similarities, gram, 1000, 0.0, 2)
    assert bool((found >= 0).all())  # nor is one of them NaN
    if what == "similarities":  # no row disturbs another
        others = [row for row in range(40) if row not in (3, 7)]
        assert torch.equal(of_core(core, similarities, gram)[others], expected[others])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"similarities": np.zeros((4, 3))}, "similarities must be a contiguous float32"),
        ({"similarities": np.zeros(4, np.float32)}, "similarities must be"),
        ({"similarities": np.zeros((4, 6), np.float32)[:, ::2]}, "similarities must be a contiguous"),
        ({"gram": np.zeros((3, 2), np.float32)}, r"gram must be .*\[3, 3\]; its axis 1 has 2 entries"),
        ({"gram": np.zeros((4, 4), np.float32)}, r"gram must be .*\[3, 3\]; its axis 0 has 4 entries"),
        ({"sweeps": -1}, "sweeps must be 0 to"),
        ({"sweeps": 1 << 40}, "sweeps must be 0 to"),
    ],
)
def test_the_core_refuses_what_does_not_fit(core: ModuleType, change: dict[str, Any], message: str) -> None:
    good = {
        "similarities": np.zeros((4, 3), np.float32),
        "gram": np.eye(3, dtype=np.float32),
        "sweeps": 3,
        "tolerance": 1e-3,
        "threads": 2,
    }
    assert not core.wide_weights(**good).any()
    with pytest.raises(ValueError, match=message):
        core.wide_weights(**{**good, **change})


def test_a_build_votes_with_them_or_with_the_codes_of_the_codebook() -> None:
    rows = 3 * clip_like(60, 16)  # of any norm
    changes: dict[str, Any] = {"n_atoms": 12, "k": 4, "seed": 1}
    book = learn_codebook(rows, BuildSettings(**changes))
    sparse = learn_codebook(rows, BuildSettings(**changes, wide=False))
    assert torch.equal(book.atoms, sparse.atoms)
    expected = wide_codes(torch.nn.functional.normalize(rows, dim=1), book.atoms, 4)
    torch.testing.assert_close(book.codes.to_dense(), expected.to_dense(), atol=1e-5, rtol=0)
    plain = fit_codes(rows, 12, 4, effort="fast", seed=1)
    assert torch.equal(sparse.codes.weights, plain.codes.weights)
    assert not torch.equal(book.codes.weights, sparse.codes.weights)
