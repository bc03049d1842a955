"""The threshold at which the answer changes least, against a slow reading of its rule; the compiled core against
torch."""

from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from raster.parity import needs_native
from scoup.query import constants, votes
from scoup.query.votes import above_thresholds, level_thresholds, stretched_counts
from support import examples, threads_of_torch

STEPS = range(44, 85)
"""Hundredths of the thresholds considered."""
GRID = 251
"""Values of ``grid_values`` lie between 0 and this; a prime, so that no rescaled one is within rounding of a
hundredth."""


def stable_thresholds(values: Tensor) -> Tensor:
    """Of rows in which all values count."""
    return level_thresholds(values, torch.ones_like(values, dtype=torch.bool))[0]


def slow_costs(values: list[float]) -> dict[int, float]:
    """Of each threshold in hundredths: the change of the logarithm of the area, with the pull."""
    low, high = min(values), max(values)
    rescaled = [min(1.0, max(0.0, 2 * (value - low) / (high - low + 1e-9) - 1)) for value in values]
    costs = {}
    for step in STEPS:  # how many are above the lower and the upper end of a window
        larger, smaller = (
            max(1, sum(value >= end / 100 for value in rescaled)) for end in (step - 5, step + 5)
        )
        costs[step] = math.log(larger) - math.log(smaller) + 0.05 * abs(step / 100 - 0.64)
    return costs


@st.composite
def grid_values(draw: st.DrawFn) -> list[int]:
    """Whole numbers from 0 to GRID, both of them among them; of several shapes, many of them alike."""
    count, seed = draw(st.integers(0, 400)), draw(st.integers(0, 2**31))
    generator = torch.Generator().manual_seed(seed)
    shares = torch.rand(count, generator=generator) ** draw(st.sampled_from([0.3, 1, 3, 10]))
    if draw(st.booleans()):
        shares = (shares * draw(st.integers(1, 12))).round() / 12
    return [0, GRID, *(shares.clamp(0, 1) * GRID).round().int().tolist()]


def test_the_constants_are_those_of_the_rule_read_here() -> None:
    assert (round(100 * constants.LOWEST), round(100 * constants.HIGHEST)) == (STEPS[0], STEPS[-1])
    assert (constants.WINDOW, constants.CENTRE, constants.PULL) == (0.1, 0.64, 0.05)


@settings(max_examples=examples(240))
@given(grid_values(), st.sampled_from([torch.float32, torch.float64]))
def test_it_is_the_slow_reading(values: list[int], dtype: torch.dtype) -> None:
    row = torch.tensor(values, dtype=dtype) / GRID
    costs = slow_costs([value / GRID for value in values])
    (threshold,) = stable_thresholds(row[None]).tolist()
    step = round(100 * threshold)
    assert threshold == pytest.approx(step / 100, abs=1e-6)
    # Two thresholds as far from the centre may cost the same but for rounding.
    assert costs[step] == pytest.approx(min(costs.values()), abs=1e-6)


@settings(max_examples=examples(40))
@given(grid_values(), st.floats(0.05, 2), st.floats(-1, 1), st.sampled_from([torch.float32, torch.float64]))
def test_scaling_and_shifting_relevancy_change_nothing(values, scale, shift, dtype) -> None:
    row = torch.tensor(values, dtype=dtype)[None] / GRID
    assert stable_thresholds(scale * row + shift).equal(stable_thresholds(row))


@pytest.mark.parametrize(("start", "expected"), [(39, 0.44), (79, 0.84)])
def test_the_first_and_the_last_window_count(start: int, expected: float) -> None:
    every_bin = [(hundredth + 0.5) / 100 for hundredth in range(100)]
    kept = [value for value in every_bin if not start <= 100 * value < start + 10]
    row = torch.tensor([-1.0, 1.0, *kept])
    assert float(stable_thresholds(row[None])) == pytest.approx(expected)


def test_rows_without_meaning_and_where_all_are_alike_have_the_centre() -> None:
    alike, odd = ([0.5] * 7, [0.4], [0.0] * 5, [0.0] * 9 + [1.0]), (torch.nan, torch.inf, -torch.inf)
    for values in (*alike, *([0.1, 0.2, number, 0.9] for number in odd), []):
        found = stable_thresholds(torch.tensor([values] * 3))
        assert found.tolist() == pytest.approx([constants.CENTRE] * 3)


def test_rows_are_judged_each_for_itself_and_always_alike() -> None:
    generator = torch.Generator().manual_seed(0)
    values = torch.rand(4, 300, generator=generator) ** torch.tensor([[0.5], [1], [2], [6]])
    thresholds = stable_thresholds(values)
    assert (thresholds.shape, thresholds.dtype) == ((4,), torch.float32)
    assert stable_thresholds(values[:, torch.randperm(300, generator=generator)]).equal(thresholds)
    assert torch.cat([stable_thresholds(row[None]) for row in values]).equal(thresholds)
    included = torch.rand(4, 300, generator=generator) < 0.6  # others do not count
    alone = [stable_thresholds(row[own][None]) for row, own in zip(values, included, strict=True)]
    assert level_thresholds(values, included)[0].equal(torch.cat(alone))
    assert len(stable_thresholds(values[:0])) == 0


@st.composite
def some_values(draw: st.DrawFn) -> tuple[Tensor, Tensor]:
    """Values [S, M] of several shapes, many of them alike or odd, and which of them count."""
    generator = torch.Generator().manual_seed(draw(st.integers(0, 2**31)))
    rows, count = draw(st.integers(1, 3)), draw(st.sampled_from([0, 1, 15, 16, 17, 333, 40_000]))
    values = torch.rand(rows, count, generator=generator) ** draw(st.sampled_from([0.3, 1, 3, 10]))
    if draw(st.booleans()):
        values = (20 * values).round() / 20
    values = values * draw(st.sampled_from([1e-30, 1, 1e30])) + draw(st.sampled_from([0, -0.5]))
    if count and draw(st.integers(0, 4)) == 0:
        values[0, count // 2] = draw(st.sampled_from([torch.nan, torch.inf, -torch.inf, 3e38]))
    return values, torch.rand(rows, count, generator=generator) < draw(st.sampled_from([0, 0.5, 1]))


@needs_native
@settings(max_examples=examples(100))
@given(some_values(), st.floats(0, 1, width=32))
def test_they_are_those_of_torch(some: tuple[Tensor, Tensor], threshold: float) -> None:
    spans, counts = stretched_counts(*some)
    expected = votes.plain_stretched_counts(*some)
    torch.testing.assert_close(spans, expected[0], rtol=0, atol=0, equal_nan=True)
    assert counts.equal(expected[1])
    thresholds = torch.full((len(spans),), threshold)
    masks, areas, sums = above_thresholds(*some, spans, thresholds)
    expected = votes.plain_above_thresholds(*some, spans, thresholds)
    assert masks.equal(expected[0])
    assert areas.equal(expected[1])
    torch.testing.assert_close(sums, expected[2], rtol=1e-12, atol=0)


@needs_native
@settings(max_examples=examples(10))
@given(st.integers(0, 99))
def test_rows_alike_have_equal_sums_for_any_number_of_threads(seed: int) -> None:
    row = torch.rand(50_000, generator=torch.Generator().manual_seed(seed))
    values, found = torch.stack([row, row, row]), []
    coded = torch.ones_like(values, dtype=torch.bool)
    for count in (1, 3):
        with threads_of_torch(count):
            spans, counts = stretched_counts(values, coded)
            found.append((counts, *above_thresholds(values, coded, spans, torch.full((3,), 0.3))))
    assert all(one.equal(other) for one, other in zip(*found, strict=True))
    assert len(set(found[0][3].tolist())) == 1
