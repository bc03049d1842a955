"""Selection of Gaussians, and selections grown, shrunk and made whole, against literal loops."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from messages import refuses
from raster.parity import needs_native
from scoup.query import constants, votes
from scoup.query.question import Question
from scoup.query.select import Reshaping, reshaped
from scoup.query.things import LONGEST_LINK, NEIGHBOURS
from scoup.query.votes import (
    MOST_TEXTS,
    above_thresholds,
    level_thresholds,
    select_by_relevancy,
    select_each,
    stretched_counts,
)
from support import examples, gaussians_at, random_gaussians, threads_of_torch


def fake_field(relevancy: Tensor, coded: Tensor) -> Any:
    """What ``select_each`` needs of a field: relevancy [S, N] looked up by the query's first number."""

    def gaussian_relevancy(queries: Tensor, canonical: Tensor) -> Tensor:
        assert canonical.shape == (4, 2)
        return torch.stack([relevancy * query[0] for query in queries], 1)

    return SimpleNamespace(coded_levels=lambda: coded, gaussian_relevancy=gaussian_relevancy)


def asked(queries: Tensor, **options: Any) -> Question:
    texts = tuple(f"text {number}" for number in range(len(queries)))
    return Question(texts, queries, torch.zeros(4, 2), torch.zeros(0, 2), **options)


def literal_above(values, coded, threshold) -> list[bool]:
    members = [i for i in range(len(values)) if coded[i]]
    low, high = (min(values[members]), max(values[members])) if members else (0, 0)
    rescaled = np.clip(2 * (values - low) / (high - low + 1e-9) - 1, 0, 1)
    return [bool(own and value > threshold) for value, own in zip(rescaled, coded, strict=True)]


def literal_select(values, coded, threshold: float | None) -> tuple[list[bool], int, float]:
    """By a threshold, and the largest peak of a level; without, by that at which each level changes least, and the
    largest mean of those selected."""
    answers = []
    for level, (row, own) in enumerate(zip(values, coded, strict=True)):
        one = torch.from_numpy(row[own])[None]
        stable = float(level_thresholds(one, torch.ones_like(one, dtype=torch.bool))[0][0])
        bound = stable if threshold is None else threshold
        chosen = literal_above(row, own, bound)
        mean = np.mean(row[chosen]) if any(chosen) else -np.inf
        answers.append((chosen, level, bound, mean, max(row[own], default=-np.inf)))
    by_mean = threshold is None and any(any(chosen) for chosen, *_ in answers)
    return max(answers, key=lambda answer: answer[3 if by_mean else 4])[:3]  # the first of equals


@settings(max_examples=examples(60))
@given(
    st.integers(1, 40), st.floats(0, 1), st.sampled_from([0.55, None]), st.sampled_from([None, 0, 2]),
    st.integers(0, 2**31),
)  # fmt: skip
def test_select_equals_loops(count, share, threshold, level, seed) -> None:
    generator = torch.Generator().manual_seed(seed)
    relevancy = torch.rand(3, count, generator=generator, dtype=torch.float64)
    coded = torch.rand(3, count, generator=generator) < share
    question = asked(torch.ones(1, 2), threshold=threshold, level=level)
    (found,) = select_each(fake_field(relevancy, coded), question)
    rows = slice(None) if level is None else slice(level, level + 1)
    values, own = relevancy.numpy()[rows], coded.numpy()[rows]
    mask, number, expected = literal_select(values, own, threshold)
    assert (found.mask.tolist(), found.level) == (mask, number + (level or 0))
    assert found.threshold == pytest.approx(expected)
    assert found.relevancy.equal(relevancy[found.level])
    mean = relevancy[found.level][mask].mean()
    assert found.fit == (pytest.approx(float(mean)) if any(mask) else -torch.inf)


@pytest.mark.parametrize("threshold", [None, 0.0, 0.6])
def test_nothing_is_selected_where_nothing_stands_out(threshold: float | None) -> None:
    for count, is_coded, level in ((5, True, 1), (5, False, 0), (0, True, 0)):
        relevancy = torch.tensor([0.4, 0.6])[:, None].expand(2, count)
        coded = torch.full((2, count), is_coded)
        found = select_by_relevancy(relevancy, coded, threshold=threshold)
        assert (found.level, found.mask.tolist()) == (level, [False] * count)
        assert level == 1 or found.fit == -torch.inf


def test_select_many_queries_and_refusals() -> None:
    relevancy = torch.tensor([[0.2, 0.9, 0.7], [0.3, 0.3, 0.3]])
    field = fake_field(relevancy, torch.tensor([[True, True, False], [True, True, True]]))
    queries = torch.tensor([[1.0, 0.0], [0.1, 0.0]]).repeat(MOST_TEXTS, 1)  # more than one pass takes
    found = list(select_each(field, asked(queries)))
    assert [each.mask.tolist() for each in found] == [[False, True, False]] * len(queries)
    for threshold in (1.5, -0.1, float("nan")):
        with refuses():
            next(select_each(field, asked(queries, threshold=threshold)))


def literal(points: np.ndarray, inside: list[bool], wanted: Reshaping) -> list[bool]:
    """Shrink, grow and within, one Gaussian at a time."""
    count = len(points)
    distances = np.linalg.norm(points[:, None] - points[None], axis=2)
    near = [sorted(range(count), key=lambda j: distances[i, j])[: NEIGHBOURS + 1] for i in range(count)]
    usual = np.median([distances[i, near[i][-1]] for i in range(count) if inside[i]]) if any(inside) else 0
    links = [[j for j in near[i] if distances[i, j] <= LONGEST_LINK * usual] for i in range(count)]
    for _ in range(wanted.shrink):
        inside = [inside[i] and all(inside[j] for j in links[i]) for i in range(count)]
    for _ in range(wanted.grow):
        inside = [any(inside[j] for j in links[i]) or inside[i] for i in range(count)]
    if wanted.within and any(inside):
        chosen = [j for j in range(count) if inside[j]]
        inside = [bool(distances[i, chosen].min() <= wanted.within) for i in range(count)]
    return inside


@settings(max_examples=examples(40))
@given(
    st.integers(2, 60),
    st.integers(0, 3),
    st.integers(0, 3),
    st.sampled_from([0.0, 0.4]),
    st.integers(0, 2**31),
)
def test_reshaped_equals_loops(count: int, shrink: int, grow: int, within: float, seed: int) -> None:
    generator = torch.Generator().manual_seed(seed)
    means = torch.randn(count, 3, generator=generator)
    mask = torch.rand(count, generator=generator) < 0.6
    wanted = Reshaping(shrink=shrink, grow=grow, within=within)
    found = reshaped(gaussians_at(means), mask, torch.ones(count), wanted)
    assert found.tolist() == literal(means.double().numpy(), mask.tolist(), wanted)


def test_the_largest_part_is_the_one_that_weighs_most() -> None:
    generator = torch.Generator().manual_seed(0)
    mask, first = torch.ones(70, dtype=torch.bool), torch.arange(70) < 40
    gaussians = gaussians_at(torch.rand(70, 3, generator=generator) + 20.0 * ~first[:, None])
    for weight, expected in ((1.0, first), (0.5, ~first)):
        weights = torch.where(first, weight, 1.0)
        assert reshaped(gaussians, mask, weights, Reshaping(largest=True)).equal(expected)
    gaussians.means[41:] += 40.0 * torch.arange(29)[:, None]  # each of them alone
    assert reshaped(gaussians, torch.arange(70) < 20, mask.float(), Reshaping(grow=5)).equal(first)


def test_ugly_gaussians_are_left_out() -> None:
    ugly = random_gaussians(30, seed=2)
    ugly.means[3], ugly.means[4] = torch.nan, torch.inf
    mask = torch.ones(30, dtype=torch.bool)
    for wanted in (Reshaping(grow=1), Reshaping(shrink=1), Reshaping(largest=True), Reshaping(within=100.0)):
        found = reshaped(ugly, mask, torch.full((30,), torch.nan), wanted)
        assert not found[3:5].any()
    assert not reshaped(ugly, ~mask, torch.ones(30), Reshaping(True, 1, 1, 1.0)).any()


def test_numbers_out_of_range_are_refused() -> None:
    wrong = (-1, -0.1, float("nan"), float("inf"))
    for name, numbers in {"grow": (*wrong, 1001), "shrink": (*wrong, 1001), "within": wrong}.items():
        for number in numbers:
            with refuses():
                Reshaping(**{name: number})  # pyright: ignore[reportArgumentType]


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
