"""Relevancy against a literal evaluation of its definition."""

from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from scoup.base import InputError
from scoup.field import relevancy
from support import examples


def literal_relevancy(query: float, canonical: list[float], temperature: float) -> float:
    pairs = []
    for other in canonical:
        ours, theirs = math.exp(temperature * query), math.exp(temperature * other)
        pairs.append(ours / (ours + theirs))
    return min(pairs)


@settings(max_examples=examples(50))
@given(st.lists(st.floats(-1, 1, width=32), min_size=2, max_size=6), st.floats(0.1, 30))
def test_relevancy_is_the_minimum_over_canonical_phrases(cosines: list[float], temperature: float) -> None:
    values = torch.tensor(cosines)[None, :, None]
    result = relevancy(values[:, :1], values[:, 1:], temperature)
    assert result.shape == (1, 1, 1)
    assert float(result) == pytest.approx(literal_relevancy(cosines[0], cosines[1:], temperature), abs=1e-5)


def test_relevancy_keeps_the_trailing_shape_and_pairs_levels_and_pixels() -> None:
    generator = torch.Generator().manual_seed(0)
    cosines = torch.rand(3, 2, 4, 5, generator=generator)
    canonical = torch.rand(3, 4, 4, 5, generator=generator)
    result = relevancy(cosines, canonical)
    assert result.shape == (3, 2, 4, 5)
    expected = literal_relevancy(float(cosines[2, 1, 3, 0]), canonical[2, :, 3, 0].tolist(), 10.0)
    assert float(result[2, 1, 3, 0]) == pytest.approx(expected, abs=1e-6)
    assert relevancy(cosines.flatten(2), canonical.flatten(2)).view(3, 2, 4, 5).equal(result)


def test_nothing_rendered_is_a_draw_and_extremes_do_not_overflow() -> None:
    zeros = torch.zeros(1, 1, 2)
    assert relevancy(zeros, zeros).tolist() == [[[0.5, 0.5]]]
    extreme = relevancy(torch.tensor([[[1.0]]]), torch.tensor([[[-1.0]]]), temperature=1e4)
    assert float(extreme) == 1.0


@pytest.mark.parametrize(
    ("queries", "canonical"),
    [
        ((2, 1, 5), (2, 0, 5)),
        ((2, 1, 5), (1, 4, 5)),
        ((2, 1, 5), (2, 4, 6)),
        ((2, 1, 5), (2, 4)),
        ((3,), (3,)),
    ],
)
def test_shapes_that_do_not_belong_together(queries: tuple[int, ...], canonical: tuple[int, ...]) -> None:
    with pytest.raises(InputError):
        relevancy(torch.zeros(queries), torch.zeros(canonical))
