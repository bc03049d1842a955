"""Selection of Gaussians, and selections grown, shrunk and made whole, against literal loops."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from messages import refuses
from scoup.query.question import Question
from scoup.query.select import Reshaping, reshaped
from scoup.query.things import LONGEST_LINK, NEIGHBOURS
from scoup.query.votes import MOST_TEXTS, level_thresholds, select_by_relevancy, select_each
from support import examples, gaussians_at, random_gaussians


def fake_field(relevancy: Tensor, coded: Tensor) -> Any:
    """What ``select_each`` needs of a field: relevancy [S, N] looked up by the query's first number."""

    def gaussian_relevancy(queries: Tensor, canonical: Tensor) -> Tensor:
        assert canonical.shape == (4, 2)
        return torch.stack([relevancy * query[0] for query in queries], 1)

    return SimpleNamespace(coded_levels=lambda: coded, gaussian_relevancy=gaussian_relevancy)


def asked(queries: Tensor, **options: Any) -> Question:
    texts = tuple(f"text {number}" for number in range(len(queries)))
    return Question(texts, queries, torch.zeros(4, 2), torch.zeros(0, 2), **options)


def literal_select(values, coded, threshold) -> list[bool]:
    peaks = [max(row[own], default=-np.inf) for row, own in zip(values, coded, strict=True)]
    level = int(np.argmax(peaks))
    return literal_above(values[level], coded[level], threshold)


def literal_above(values, coded, threshold) -> list[bool]:
    members = [i for i in range(len(values)) if coded[i]]
    low, high = (min(values[members]), max(values[members])) if members else (0, 0)
    rescaled = np.clip(2 * (values - low) / (high - low + 1e-9) - 1, 0, 1)
    return [bool(own and value > threshold) for value, own in zip(rescaled, coded, strict=True)]


def literal_stable_select(values, coded) -> tuple[list[bool], int, float]:
    """By the threshold at which each level changes least, and the largest mean of those selected."""
    answers = []
    for level, (row, own) in enumerate(zip(values, coded, strict=True)):
        one = torch.from_numpy(row[own])[None]
        threshold = float(level_thresholds(one, torch.ones_like(one, dtype=torch.bool))[0][0])
        chosen = literal_above(row, own, threshold)
        mean = np.mean(row[chosen]) if any(chosen) else -np.inf
        peak = max(row[own], default=-np.inf)
        answers.append((chosen, level, threshold, mean, peak))
    by_mean = any(any(chosen) for chosen, *_ in answers)
    return max(answers, key=lambda answer: answer[3 if by_mean else 4])[:3]  # the first of equals


@settings(max_examples=examples(60))
@given(
    st.integers(1, 40), st.floats(0, 1), st.sampled_from([0.55, None]), st.sampled_from([None, 0, 2]),
    st.integers(0, 2**31),
)  # fmt: skip
def test_select_equals_loops(
    count: int, share: float, threshold: float | None, level: int | None, seed: int
) -> None:
    generator = torch.Generator().manual_seed(seed)
    relevancy = torch.rand(3, count, generator=generator, dtype=torch.float64)
    coded = torch.rand(3, count, generator=generator) < share
    question = asked(torch.ones(1, 2), threshold=threshold, level=level)
    (found,) = select_each(fake_field(relevancy, coded), question)
    rows = slice(None) if level is None else slice(level, level + 1)
    values, own = relevancy.numpy()[rows], coded.numpy()[rows]
    if threshold is not None:
        assert found.mask.tolist() == literal_select(values, own, threshold)
        return
    mask, number, expected = literal_stable_select(values, own)
    assert (found.mask.tolist(), found.level) == (mask, number + (level or 0))
    assert found.threshold == pytest.approx(expected)
    assert found.relevancy.equal(relevancy[found.level])
    mean = relevancy[found.level][mask].mean()
    assert found.fit == (pytest.approx(float(mean)) if any(mask) else -torch.inf)


def test_of_levels_alike_the_first_answers() -> None:
    relevancy = torch.tensor([0.3] * 12 + [0.85] * 8).expand(2, 20)
    for threshold in (0.6, None):
        found = select_by_relevancy(relevancy, torch.ones(2, 20, dtype=torch.bool), threshold=threshold)
        assert (found.level, found.fit) == (0, pytest.approx(0.85))
        assert found.threshold == pytest.approx(threshold or 0.64)


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
