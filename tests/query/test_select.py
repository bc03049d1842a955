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
from scoup.query.select import ABSOLUTE_THRESHOLD, select_by_relevancy, select_each
from scoup.query.stable_threshold import stable_thresholds
from scoup.scene.neighbours import Neighbourhood
from support import examples


def fake_field(relevancy: Tensor, coded: Tensor, means: Tensor) -> SimpleNamespace:
    """What ``select`` needs of a field: relevancy [S, N] looked up by the query's first number."""

    def gaussian_relevancy(queries: Tensor, canonical: Tensor) -> Tensor:
        assert canonical.shape == (4, 2)
        return torch.stack([relevancy * query[0] for query in queries], 1)

    return SimpleNamespace(
        coded_levels=lambda: coded,
        gaussian_relevancy=gaussian_relevancy,
        gaussians=SimpleNamespace(means=means),
    )


def literal_values(relevancy, coded, means, neighbours) -> np.ndarray:
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
    return values


def literal_select(relevancy, coded, means, threshold, neighbours, rescaled) -> list[bool]:
    levels, count = relevancy.shape
    values = literal_values(relevancy, coded, means, neighbours)
    peaks = [max((values[s, i] for i in range(count) if coded[s, i]), default=-np.inf) for s in range(levels)]
    level = int(np.argmax(peaks))
    return literal_above(values[level], coded[level], threshold, rescaled)


def literal_above(values, coded, threshold, rescaled=True) -> list[bool]:
    members = [i for i in range(len(values)) if coded[i]]
    chosen = [False] * len(values)
    low, high = (min(values[members]), max(values[members])) if members else (0, 0)
    for i in members:
        value = values[i]
        if rescaled:
            value = np.clip(2 * (value - low) / (high - low + 1e-9) - 1, 0, 1)
        chosen[i] = bool(value > threshold)
    return chosen


def literal_stable_select(relevancy, coded, means, neighbours) -> tuple[list[bool], int, float]:
    """By the threshold at which each level changes least, and the largest mean of those selected."""
    values = literal_values(relevancy, coded, means, neighbours)
    answers = []
    for level, (row, own) in enumerate(zip(values, coded, strict=True)):
        threshold = float(stable_thresholds(torch.from_numpy(row[own])[None])[0])
        chosen = literal_above(row, own, threshold)
        mean = np.mean(row[chosen]) if any(chosen) else -np.inf
        peak = max(row[own], default=-np.inf)
        answers.append((chosen, level, threshold, mean, peak))
    by_mean = any(any(chosen) for chosen, *_ in answers)
    return max(answers, key=lambda answer: answer[3 if by_mean else 4])[:3]  # the first of equals


@settings(max_examples=examples(30))
@given(st.integers(1, 40), st.sampled_from([None, 1, 10]), st.booleans(), st.integers(0, 2**31))
def test_select_equals_loops(count: int, neighbours: int | None, rescaled: bool, seed: int) -> None:
    generator = torch.Generator().manual_seed(seed)
    relevancy = torch.rand(3, count, generator=generator)
    coded = torch.rand(3, count, generator=generator) < 0.6
    means = torch.randn(count, 3, generator=generator)
    field = fake_field(relevancy, coded, means)
    (chosen,) = select_each(field, torch.ones(1, 2), torch.zeros(4, 2), 0.55, neighbours, rescaled)  # pyright: ignore
    expected = literal_select(
        relevancy.double().numpy(), coded.numpy(), means.double().numpy(), 0.55, neighbours, rescaled
    )
    assert chosen.mask.tolist() == expected


@settings(max_examples=examples(40))
@given(st.integers(1, 40), st.sampled_from([None, 1, 10]), st.floats(0, 1), st.integers(0, 2**31))
def test_without_a_threshold_it_is_the_most_stable_one(
    count: int, neighbours: int | None, share: float, seed: int
) -> None:
    generator = torch.Generator().manual_seed(seed)
    # In float64, where blending rounds nothing into another bin of the thresholds.
    relevancy = torch.rand(3, count, generator=generator, dtype=torch.float64)
    coded = torch.rand(3, count, generator=generator) < share
    means = torch.randn(count, 3, generator=generator)
    field = fake_field(relevancy, coded, means)
    (found,) = select_each(field, torch.ones(1, 2), torch.zeros(4, 2), neighbours=neighbours)  # pyright: ignore
    expected = literal_stable_select(relevancy.numpy(), coded.numpy(), means.double().numpy(), neighbours)
    assert (found.mask.tolist(), found.level) == expected[:2]
    assert found.threshold == pytest.approx(expected[2])
    own = found.relevancy[coded[found.level]]
    assert found.score == (float(own.max()) if len(own) else -torch.inf)


def test_the_level_by_its_peak_with_a_threshold_and_by_its_mean_without() -> None:
    relevancy = torch.full((3, 20), 0.3)
    relevancy[0, :8] = 0.8  # a few higher, most of them lower
    relevancy[0, 0] = 0.9
    relevancy[1, :8] = 0.85
    coded = torch.ones(3, 20, dtype=torch.bool)
    coded[2] = False
    by_peak, by_mean = (
        select_by_relevancy(relevancy, coded, threshold=0.6),
        select_by_relevancy(relevancy, coded),
    )
    assert (by_peak.level, by_peak.threshold, by_mean.level) == (0, 0.6, 1)
    assert by_peak.score == pytest.approx(0.9)
    assert by_mean.score == pytest.approx(0.85)
    assert by_mean.threshold == pytest.approx(0.64)
    assert by_mean.mask.nonzero()[:, 0].tolist() == list(range(8))
    # Levels alike: the first answers.
    assert select_by_relevancy(relevancy[[1, 1]], coded[:2]).level == 0


def test_the_threshold_of_a_level_knows_only_its_coded_gaussians() -> None:
    relevancy = torch.cat([torch.full((30,), 0.5), torch.full((10,), 0.7), torch.full((5,), 0.99)])[None]
    coded = torch.ones(1, 45, dtype=torch.bool)
    coded[0, 40:] = False
    found = select_by_relevancy(relevancy, coded)
    assert found.mask.nonzero()[:, 0].tolist() == list(range(30, 40))
    assert found.score == pytest.approx(0.7)


@pytest.mark.parametrize("threshold", [None, 0.0, 0.6])
def test_nothing_is_selected_where_nothing_stands_out(threshold: float | None) -> None:
    relevancy = torch.tensor([0.4, 0.6])[:, None].expand(2, 5)
    found = select_by_relevancy(relevancy, torch.ones(2, 5, dtype=torch.bool), threshold=threshold)
    assert (found.level, bool(found.mask.any())) == (1, False)
    nobody = select_by_relevancy(relevancy, torch.zeros(2, 5, dtype=torch.bool), threshold=threshold)
    assert (nobody.level, bool(nobody.mask.any()), nobody.score) == (0, False, -torch.inf)
    empty = select_by_relevancy(torch.zeros(2, 0), torch.zeros(2, 0).bool(), threshold=threshold)
    assert (empty.level, len(empty.mask), empty.score) == (0, 0, -torch.inf)


def test_an_absolute_threshold_is_never_the_most_stable_one() -> None:
    relevancy = torch.tensor([[0.2, 0.3, 0.55, 0.65]])
    coded = torch.ones(1, 4, dtype=torch.bool)
    found = select_by_relevancy(relevancy, coded, rescaled=False)
    assert (found.mask.tolist(), found.threshold) == ([False, False, False, True], ABSOLUTE_THRESHOLD)
    assert not select_by_relevancy(0.5 * relevancy, coded, rescaled=False).mask.any()


def test_select_many_queries_and_refusals() -> None:
    field = fake_field(
        torch.tensor([[0.2, 0.9, 0.7]]), torch.tensor([[True, True, False]]), torch.zeros(3, 3)
    )
    queries = torch.tensor([[1.0, 0.0], [0.1, 0.0]])
    chosen = select_each(field, queries, torch.zeros(4, 2), rescaled=False)  # pyright: ignore
    assert [each.mask.tolist() for each in chosen] == [[False, True, False], [False, False, False]]
    assert list(select_each(field, queries[:0], torch.zeros(4, 2))) == []  # pyright: ignore
    with pytest.raises(InputError):
        next(select_each(field, queries, torch.zeros(4, 2), neighbours=0))  # pyright: ignore
    with pytest.raises(InputError, match="0 to 1"):
        next(select_each(field, queries, torch.zeros(4, 2), 1.5))  # pyright: ignore


def test_neighbours_at_one_place_and_not_finite() -> None:
    points = torch.zeros(30, 3)
    points[29] = torch.nan
    around = Neighbourhood.of(points, torch.ones(30, dtype=torch.bool), 5)
    assert around.nearest.shape == (29, 5)
    assert not (around.nearest == around.members[:, None]).any()
    alone = Neighbourhood.of(points[:1], torch.ones(1, dtype=torch.bool), 5)
    assert alone.blend(torch.tensor([[0.25]]), torch.ones(1, 1, dtype=torch.bool)).tolist() == [[0.25]]
