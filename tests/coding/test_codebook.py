"""A codebook meets rows that it was not learned from: it marks those that it explains badly."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from messages import refuses
from scoup.coding import Codebook, fit_codes
from scoup.coding.report import decoded_cosines, explained_from

KNOWN, UNSEEN = 200, 8  # things


class ThingTable:
    """Rows as CLIP gives them: a mean of all, things with long-tailed frequencies, noise. Cosine about 0.5 between
    things and 0.85 within one.
    """

    def __init__(self, seed: int, dim: int = 256) -> None:
        self._generator = torch.Generator().manual_seed(seed)
        self._mean = torch.randn(dim, generator=self._generator)
        directions = torch.randn(KNOWN + UNSEEN, dim, generator=self._generator)
        self._things = torch.nn.functional.normalize(directions, dim=1) * dim**0.5

    def known(self, count: int, of: int = KNOWN) -> Tensor:
        frequency = 1 / torch.arange(1, of + 1)
        return self._rows(torch.multinomial(frequency, count, True, generator=self._generator))

    def unseen(self, count: int) -> Tensor:
        return self._rows(KNOWN + torch.randint(UNSEEN, (count,), generator=self._generator))

    def _rows(self, which: Tensor) -> Tensor:
        noise = torch.randn(len(which), len(self._mean), generator=self._generator)
        return torch.nn.functional.normalize(self._mean + 0.85 * self._things[which] + 0.5 * noise, dim=1)


def learned(count: int = 60, n_atoms: int = 12, seed: int = 0) -> tuple[Codebook, Tensor]:
    generator = torch.Generator().manual_seed(seed)
    rows = torch.randn(count, 16, generator=generator).abs()
    rows[:, 12:] = 0  # directions that no row has
    return fit_codes(rows, n_atoms, 3, solver="exact"), rows


def strange(count: int, seed: int = 5) -> Tensor:
    """Rows in directions that ``learned`` has never seen."""
    rows = torch.zeros(count, 16)
    rows[:, 12:] = torch.rand(count, 4, generator=torch.Generator().manual_seed(seed)) + 0.01
    return rows


def test_false_alarms_stay_few_where_atoms_are_many() -> None:
    """A codebook fits its own rows too well to judge others by them: the bar allows for that."""
    things = ThingTable(3)
    for count in (100, 200, 800):
        book = fit_codes(things.known(count, 20), 64, 4, solver="exact")
        others = book.encode(things.known(400, 20))
        # Why the 5th percentile itself will not do.
        assert float((others.cosines < book.report.low_cosine).float().mean()) > 0.5
        assert float(others.badly_explained.float().mean()) < 0.15
        assert float(book.encode(things.unseen(100)).badly_explained.float().mean()) > 0.9


def test_cosines_and_marks() -> None:
    book, rows = learned()
    mixed = torch.cat([rows[:5], strange(2), torch.zeros(2, 16), -rows[:1]])
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


def test_the_bar_of_a_report() -> None:
    # Many rows an atom: the 5th percentile itself. Three rows an atom: twice as far from 1. Fewer rows than atoms: it.
    assert explained_from(0.8, 1_000_000, 64) == pytest.approx(0.8, abs=1e-4)
    assert explained_from(0.8, 192, 64) == pytest.approx(0.6, abs=1e-4)
    assert explained_from(0.8, 64, 64) == pytest.approx(0.8, abs=1e-4)
    assert 0 < explained_from(0.5, 65, 64) < 0.1
    book, rows = learned()
    assert book.report.explained_from == explained_from(book.report.low_cosine, 60, 12)
    exact = fit_codes(rows[:6], 8, 3, solver="exact")
    assert not exact.encode(rows[:6]).badly_explained.any()
    nothing = fit_codes(torch.zeros(3, 16), 4, 2)
    assert nothing.encode(rows[:2]).badly_explained.all()


def test_refusals() -> None:
    book, rows = learned()
    for wrong in (
        torch.zeros(2, 15), torch.full((2, 16), float("nan")), torch.zeros(2, 16, dtype=torch.int32), rows[0]
    ):  # fmt: skip
        with refuses():
            book.encode(wrong)
