"""Rescaled relevancy counted and compared with thresholds: the compiled core against torch, bit by bit."""

from __future__ import annotations

import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from raster.parity import needs_native
from scoup.query import votes
from scoup.query.votes import above_thresholds, stretched_counts
from support import examples, threads_of_torch


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
