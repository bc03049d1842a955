"""The public face of stage 1: what goes in, what comes out, what is refused."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from messages import refuses
from scoup.coding import fit_codes
from scoup.coding.codebook import encode
from scoup.coding.report import report_on
from scoup.scene import SparseCodes
from support import examples


def random_rows(count: int, dim: int = 16, seed: int = 0) -> Tensor:
    return torch.randn(count, dim, generator=torch.Generator().manual_seed(seed)) + 0.5


def assert_valid(codes: SparseCodes, rows: Tensor) -> None:
    assert len(codes) == len(rows)
    assert bool((codes.weights >= 0).all())
    assert bool((codes.weights[:, :-1] >= codes.weights[:, 1:]).all())
    expected = (torch.linalg.vector_norm(rows, dim=1) > 0).float()
    torch.testing.assert_close(codes.weights.sum(1), expected)
    assert int(codes.indices.long().max()) < codes.n_atoms
    for indices, weights in zip(codes.indices.tolist(), codes.weights.tolist(), strict=True):
        used = [index for index, weight in zip(indices, weights, strict=True) if weight > 0]
        assert len(set(used)) == len(used)


def test_codes_and_report() -> None:
    rows = random_rows(60)
    seen: list[tuple[str, int, int]] = []
    book = fit_codes(
        rows, n_atoms=12, k=3, solver="adam", epochs=30, progress=lambda *call: seen.append(call)
    )
    assert_valid(book.codes, rows)
    assert book.atoms.shape == (12, 16)
    assert [done for _, done, _ in seen] == list(range(31))
    assert {total for _, _, total in seen} == {30}
    decoded = book.codes.to_dense() @ book.atoms
    cosines = torch.nn.functional.cosine_similarity(decoded, rows, dim=1)
    assert book.report.loss == pytest.approx(float(1 - cosines.mean()), abs=1e-6)
    assert book.report.mean_cosine == pytest.approx(float(cosines.mean()), abs=1e-6)
    assert book.report.low_cosine == pytest.approx(float(cosines.quantile(0.05)), abs=1e-6)
    used = {int(index) for index in book.codes.indices[book.codes.weights > 0]}
    assert book.report.dead_atoms == pytest.approx(1 - len(used) / 12)
    assert (book.report.epochs, book.report.regions, book.report.solver) == (30, 60, "adam")
    assert "mean cosine" in str(book.report)


def test_same_seed_same_bytes_and_norms_do_not_matter() -> None:
    rows = torch.nn.functional.normalize(random_rows(50), dim=1)
    first, second = (fit_codes(rows, 8, 2, solver="adam", epochs=20, seed=1) for _ in range(2))
    assert first.atoms.equal(second.atoms)
    assert first.codes.weights.equal(second.codes.weights)
    scaled = fit_codes(
        rows * torch.tensor([1e-30, 7.0]).repeat(25)[:, None], 8, 2, solver="adam", epochs=20, seed=1
    )
    torch.testing.assert_close(scaled.atoms, first.atoms, atol=1e-4, rtol=0)


@pytest.mark.parametrize("count", [0, 3])
def test_nothing_to_code(count: int) -> None:
    book = fit_codes(torch.zeros(count, 8), n_atoms=4, k=2)
    assert book.codes.weights.tolist() == [[0.0, 0.0]] * count
    assert (book.report.regions, book.report.dead_atoms, book.report.epochs) == (0, 1.0, 0)


@settings(max_examples=examples(25))
@given(st.integers(1, 12), st.sampled_from([1, 2, 3, 5, 8, 20, 300]), st.integers(1, 8), st.integers(1, 4))
def test_any_sizes(count: int, n_atoms: int, k: int, distinct: int) -> None:
    rows = random_rows(distinct, 6).abs()[torch.arange(count) % distinct]
    book = fit_codes(rows, n_atoms, k, solver="adam", epochs=3)
    assert book.codes.k == k
    assert_valid(book.codes, rows)
    assert_valid(book.encode(rows).codes, rows)
    assert book.codes.indices.dtype == (torch.uint8 if n_atoms <= 256 else torch.uint16)


@pytest.mark.parametrize("change", [
    {"embeddings": torch.tensor([[1.0, float("nan")]])}, {"embeddings": torch.tensor([[1.0, float("inf")]])},
    {"embeddings": torch.zeros(3)}, {"embeddings": torch.zeros(3, 4, dtype=torch.int32)},
    {"solver": "newton"}, {"k": 0}, {"n_atoms": 0}, {"epochs": -1},
])  # fmt: skip
def test_refusals(change: dict) -> None:
    with refuses():
        fit_codes(**{"embeddings": random_rows(5), "solver": "adam", "epochs": 1, **change})


def test_encode_with_one_atom_a_row_is_the_nearest_atom() -> None:
    rows, atoms = random_rows(50), random_rows(9, seed=2)
    codes = encode(rows, atoms, 1)
    nearest = (rows @ torch.nn.functional.normalize(atoms, dim=1).T).argmax(1)
    assert codes.indices[:, 0].long().equal(nearest)
    assert codes.weights.tolist() == [[1.0]] * 50


def test_encode_recovers_codes_and_improves_on_the_learned_ones() -> None:
    atoms = torch.linalg.qr(random_rows(16)).Q
    truth = SparseCodes.from_dense(torch.rand(30, 16, generator=torch.Generator().manual_seed(0)), 3)
    codes = encode(truth.to_dense() @ atoms, atoms, 3)
    torch.testing.assert_close(codes.to_dense(), truth.to_dense(), atol=1e-5, rtol=0)
    rows = random_rows(200)
    book = fit_codes(rows, n_atoms=24, k=3, solver="adam", epochs=100)
    again = report_on(rows, book.atoms, book.encode(rows).codes)
    assert again.loss < book.report.loss


def test_encode_of_rows_that_no_atom_helps() -> None:
    atoms = torch.eye(3)
    assert encode(-torch.ones(2, 3), atoms, 2).weights.tolist() == [[0.0, 0.0]] * 2
    assert encode(torch.ones(1, 3), torch.zeros(3, 3), 2).weights.tolist() == [[0.0, 0.0]]
    duplicates = torch.ones(5, 3)
    assert encode(torch.ones(1, 3), duplicates, 3).weights.tolist() == [[1.0, 0.0, 0.0]]
