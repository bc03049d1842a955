"""Selection of Gaussians against literal loops."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from scoup.base.errors import InputError
from scoup.query.neighbours import Neighbourhood
from scoup.query.select import select


def fake_field(relevancy: Tensor, coded: Tensor, means: Tensor) -> SimpleNamespace:
    """What ``select`` needs of a field: relevancy [S, N] looked up by the query's first number."""

    def gaussian_relevancy(queries: Tensor, canonical: Tensor) -> Tensor:
        assert canonical.shape == (4, 2)
        return torch.stack([relevancy * query[0] for query in queries], 1)

    weights = coded.T[:, :, None].float()  # [N, S, 1]
    return SimpleNamespace(
        code_weights=weights, gaussian_relevancy=gaussian_relevancy, gaussians=SimpleNamespace(means=means)
    )


def literal_select(relevancy, coded, means, threshold, neighbours, rescaled) -> list[bool]:
    levels, count = relevancy.shape
    values = relevancy.copy()
    if neighbours:
        anywhere = [i for i in range(count) if coded[:, i].any()]
        for i in anywhere:
            others = sorted((j for j in anywhere if j != i), key=lambda j: np.sum((means[i] - means[j]) ** 2))
            for level in range(levels):
                near = [relevancy[level, j] for j in others[:neighbours] if coded[level, j]]
                if near:
                    values[level, i] = 0.5 * (relevancy[level, i] + np.mean(near))
    peaks = [max((values[s, i] for i in range(count) if coded[s, i]), default=-np.inf) for s in range(levels)]
    level = int(np.argmax(peaks))
    members = [i for i in range(count) if coded[level, i]]
    chosen = [False] * count
    low, high = (min(values[level, members]), max(values[level, members])) if members else (0, 0)
    for i in members:
        value = values[level, i]
        if rescaled:
            value = np.clip(2 * (value - low) / (high - low + 1e-9) - 1, 0, 1)
        chosen[i] = bool(value > threshold)
    return chosen


@settings(max_examples=30)
@given(st.integers(1, 40), st.sampled_from([None, 1, 10]), st.booleans(), st.integers(0, 2**31))
def test_select_equals_loops(count: int, neighbours: int | None, rescaled: bool, seed: int) -> None:
    generator = torch.Generator().manual_seed(seed)
    relevancy = torch.rand(3, count, generator=generator)
    coded = torch.rand(3, count, generator=generator) < 0.6
    means = torch.randn(count, 3, generator=generator)
    field = fake_field(relevancy, coded, means)
    chosen = select(field, torch.ones(2), torch.zeros(4, 2), 0.55, neighbours, rescaled)  # pyright: ignore
    expected = literal_select(
        relevancy.double().numpy(), coded.numpy(), means.double().numpy(), 0.55, neighbours, rescaled
    )
    assert chosen.tolist() == expected


def test_select_many_queries_and_refusals() -> None:
    field = fake_field(
        torch.tensor([[0.2, 0.9, 0.7]]), torch.tensor([[True, True, False]]), torch.zeros(3, 3)
    )
    queries = torch.tensor([[1.0, 0.0], [0.1, 0.0]])
    chosen = select(field, queries, torch.zeros(4, 2), rescaled=False)  # pyright: ignore
    assert chosen.tolist() == [[False, True, False], [False, False, False]]
    assert select(field, queries[:0], torch.zeros(4, 2)).shape == (0, 3)  # pyright: ignore
    with pytest.raises(InputError):
        select(field, queries[0], torch.zeros(4, 2), neighbours=0)  # pyright: ignore


def test_neighbours_at_one_place_and_not_finite() -> None:
    points = torch.zeros(30, 3)
    points[29] = torch.nan
    around = Neighbourhood.of(points, torch.ones(30, dtype=torch.bool), 5)
    assert around.nearest.shape == (29, 5)
    assert not (around.nearest == around.members[:, None]).any()
    alone = Neighbourhood.of(points[:1], torch.ones(1, dtype=torch.bool), 5)
    assert alone.blend(torch.tensor([[0.25]]), torch.ones(1, 1, dtype=torch.bool)).tolist() == [[0.25]]
