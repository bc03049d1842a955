"""Embeddings that take few values get these values as atoms, and codes of one atom."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from scoup.coding import fit_codes
from scoup.coding.distinct import distinct_rows, value_codes
from scoup.coding.exact import solve_exact
from scoup.scene import normalise_embeddings


def values(count: int, dim: int = 32, seed: int = 0) -> Tensor:
    """[count, dim] unit vectors with cosines of about .5."""
    generator = torch.Generator().manual_seed(seed)
    rows = torch.randn(count, dim, generator=generator) + torch.randn(1, dim, generator=generator)
    return torch.nn.functional.normalize(rows, dim=1)


def classes(n_rows: int, count: int, seed: int = 1) -> Tensor:
    """[n_rows] int64, each of ``count`` at least once."""
    drawn = torch.randint(count, (n_rows,), generator=torch.Generator().manual_seed(seed))
    drawn[:count] = torch.arange(count)
    return drawn


def test_ten_values_among_500_rows_are_coded_without_loss(backend: str) -> None:
    of_row = classes(500, 10)
    norms = torch.rand(500, 1, generator=torch.Generator().manual_seed(0)) + 0.1
    seen: list[tuple[int, int]] = []
    book = fit_codes(
        norms * values(10)[of_row],
        128,
        4,
        backend=backend,
        progress=lambda _, done, total: seen.append((done, total)),
    )
    assert seen == [(0, 1), (1, 1)]
    assert (book.codes.weights[:, 0] == 1).all()
    assert not book.codes.weights[:, 1:].any()
    assert book.codes.indices[:, 0].long().equal(of_row)
    assert book.atoms[:10].allclose(values(10), atol=1e-6)
    assert not book.atoms[10:].any()
    assert book.report.loss == pytest.approx(0, abs=1e-6)
    assert (book.report.epochs, book.report.dead_atoms) == (0, pytest.approx(118 / 128))
    known = book.encode(values(10))
    assert known.codes.indices[:, 0].tolist() == list(range(10))
    assert known.codes.weights.tolist() == [[1, 0, 0, 0]] * 10
    assert not known.badly_explained.any()
    assert book.encode(values(2, seed=5)).badly_explained.all()  # new ones


def test_near_copies_are_one_value_and_others_are_not() -> None:
    of_row = classes(300, 8)
    noise = torch.randn(300, 32, generator=torch.Generator().manual_seed(2))
    rows = values(8)[of_row]
    copies = torch.nn.functional.normalize(rows + 1e-5 * noise, dim=1)
    found = distinct_rows(copies, 20)
    assert found is not None
    assert len(found[0]) == 8
    assert found[1].equal(of_row)
    assert distinct_rows(torch.nn.functional.normalize(rows + 1e-3 * noise, dim=1), 20) is None
    none = distinct_rows(torch.zeros(0, 4), 3)
    assert none is not None
    assert (list(none[0].shape), len(none[1])) == ([0, 4], 0)


def test_sizes() -> None:
    of_row = classes(60, 10)
    rows = values(10)[of_row]
    for n_atoms, k in ((10, 1), (10, 10), (300, 4), (12, 16)):
        found = value_codes(rows, n_atoms, k)
        assert found is not None
        atoms, codes = found
        assert (list(atoms.shape), codes.k, codes.n_atoms) == ([n_atoms, 32], k, n_atoms)
        assert codes.indices[:, 0].long().equal(of_row)
        assert codes.weights.sum(1).equal(torch.ones(60))
    # Too many values are learned: more than atoms, or fewer than two rows a value.
    for given in ((rows, 9, 2), (rows[:19], 32, 2), (rows[:10], 32, 2)):
        assert value_codes(*given) is None


@pytest.mark.parametrize("n_atoms", [4, 64])
def test_rows_that_all_differ_are_coded_as_ever(n_atoms: int) -> None:
    rows = values(50)
    book, learned = fit_codes(rows, n_atoms, 3), solve_exact(normalise_embeddings(rows), n_atoms, 3)
    assert book.atoms.equal(learned.atoms)
    assert book.codes.indices.equal(learned.codes.indices)
    assert book.codes.weights.equal(learned.codes.weights)
