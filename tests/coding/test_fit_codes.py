"""The public face of stage 1: what goes in, what comes out, what is refused; and rows that a codebook does not know."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from messages import refuses
from scoup.coding import Codebook, fit_codes
from scoup.coding.codebook import encode
from scoup.coding.report import decoded_cosines, explained_from, report_on
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
    book = fit_codes(rows, 12, 3, solver="adam", epochs=30, progress=lambda *call: seen.append(call))
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
    scaled = rows * torch.tensor([1e-30, 7.0]).repeat(25)[:, None]
    scaled = fit_codes(scaled, 8, 2, solver="adam", epochs=20, seed=1)
    torch.testing.assert_close(scaled.atoms, first.atoms, atol=1e-4, rtol=0)


@pytest.mark.parametrize("count", [0, 3])
def test_nothing_to_code(count: int) -> None:
    book = fit_codes(torch.zeros(count, 8), n_atoms=4, k=2)
    assert book.encode(random_rows(2, 8)).badly_explained.all()
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


def test_encode_recovers_codes_and_improves_on_the_learned_ones() -> None:
    atoms = torch.linalg.qr(random_rows(16)).Q
    truth = SparseCodes.from_dense(torch.rand(30, 16, generator=torch.Generator().manual_seed(0)), 3)
    codes = encode(truth.to_dense() @ atoms, atoms, 3)
    torch.testing.assert_close(codes.to_dense(), truth.to_dense(), atol=1e-5, rtol=0)
    rows = random_rows(200)
    book = fit_codes(rows, n_atoms=24, k=3, solver="adam", epochs=100)
    again = report_on(rows, book.atoms, book.encode(rows).codes)
    assert again.loss < book.report.loss


# Rows that a codebook was not learned from: it marks those that it explains badly.


@pytest.fixture(scope="module")
def learned() -> tuple[Codebook, Tensor]:
    rows = torch.randn(60, 16, generator=torch.Generator().manual_seed(0)).abs()
    rows[:, 12:] = 0  # directions that no row has
    return fit_codes(rows, 12, 3, solver="exact"), rows


def test_false_alarms_stay_few_where_atoms_are_many() -> None:
    """A codebook fits its own rows too well to judge others by them: the bar allows for that.

    Rows are as CLIP gives them: a mean of all, 20 things with long-tailed frequencies, noise; the cosine is about 0.5
    between things and 0.85 within one.
    """
    random = torch.Generator().manual_seed(3)
    mean = torch.randn(256, generator=random)
    things = 16 * torch.nn.functional.normalize(torch.randn(28, 256, generator=random), dim=1)

    def rows_of(which: Tensor) -> Tensor:
        noise = torch.randn(len(which), 256, generator=random)
        return torch.nn.functional.normalize(mean + 0.85 * things[which] + 0.5 * noise, dim=1)

    def known(count: int) -> Tensor:
        return rows_of(torch.multinomial(1 / torch.arange(1, 21), count, True, generator=random))

    for count in (100, 200, 800):
        book = fit_codes(known(count), 64, 4, solver="exact")
        others = book.encode(known(400))
        unseen = book.encode(rows_of(torch.randint(20, 28, (100,), generator=random)))
        # Why the 5th percentile itself will not do.
        assert float((others.cosines < book.report.low_cosine).float().mean()) > 0.5
        assert float(others.badly_explained.float().mean()) < 0.15
        assert float(unseen.badly_explained.float().mean()) > 0.9


def test_cosines_and_marks(learned: tuple[Codebook, Tensor]) -> None:
    book, rows = learned
    strange = torch.zeros(2, 16)
    strange[:, 12:] = torch.rand(2, 4, generator=torch.Generator().manual_seed(5)) + 0.01
    mixed = torch.cat([rows[:5], strange, torch.zeros(2, 16), -rows[:1]])
    encoded = book.encode(7 * mixed)
    expected = decoded_cosines(torch.nn.functional.normalize(mixed, dim=1), book.atoms, encoded.codes)
    assert encoded.cosines.dtype == torch.float32
    torch.testing.assert_close(encoded.cosines, expected)
    # Nothing to explain is not badly explained; what has no code at all is.
    assert encoded.badly_explained.tolist() == [False] * 5 + [True] * 2 + [False] * 2 + [True]
    assert encoded.cosines[7:].tolist() == [0.0, 0.0, 0.0]
    assert encoded.codes.weights[7:].sum() == 0
    empty = book.encode(torch.zeros(0, 16))
    assert (len(empty.codes), len(empty.cosines), len(empty.badly_explained)) == (0, 0, 0)


def test_the_bar_of_a_report(learned: tuple[Codebook, Tensor]) -> None:
    # Many rows an atom: the 5th percentile itself. Three rows an atom: twice as far from 1. Fewer rows than atoms: it.
    assert explained_from(0.8, 1_000_000, 64) == pytest.approx(0.8, abs=1e-4)
    assert explained_from(0.8, 192, 64) == pytest.approx(0.6, abs=1e-4)
    assert explained_from(0.8, 64, 64) == pytest.approx(0.8, abs=1e-4)
    assert 0 < explained_from(0.5, 65, 64) < 0.1
    book, rows = learned
    assert book.report.explained_from == explained_from(book.report.low_cosine, 60, 12)
    exact = fit_codes(rows[:6], 8, 3, solver="exact")
    assert not exact.encode(rows[:6]).badly_explained.any()


def test_rows_that_cannot_be_encoded_are_refused(learned: tuple[Codebook, Tensor]) -> None:
    book, rows = learned
    for wrong in (rows[:2, 1:], rows[:2] * torch.nan, rows[:2].int(), rows[0]):
        with refuses():
            book.encode(wrong)
