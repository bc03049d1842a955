"""Nearest neighbours and linked parts: the compiled core against scipy and against loops."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import cdist

from raster.parity import needs_native
from scoup.base import native_core
from scoup.scene import neighbours
from scoup.scene.neighbours import linked_parts, nearest_points
from support import examples, threads_of_torch


@st.composite
def some_points(draw: st.DrawFn) -> np.ndarray:
    """Points [M, 3] in clusters of several sizes, some of them in a plane, on a line, on a grid, or at one place."""
    random = np.random.default_rng(draw(st.integers(0, 2**31)))
    count = draw(st.sampled_from([1, 2, 9, 16, 17, 33, 300, 2000]))
    points = random.normal(size=(count, 3)) * 10.0 ** random.integers(-3, 4, (count, 1))
    points[:, : draw(st.integers(0, 3))] *= 0
    if draw(st.booleans()):
        points = points.round(1)
    return points * draw(st.sampled_from([1e-9, 1, 1e9]))


def literal(points: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Of equals the one with the lower number."""
    lengths = cdist(points, points)
    np.fill_diagonal(lengths, np.inf)
    order = np.argsort(lengths, axis=1, kind="stable")[:, :count]
    return order, np.take_along_axis(lengths, order, 1)


@needs_native
@settings(max_examples=examples(60))
@given(some_points(), st.integers(0, 12))
def test_the_nearest_are_those_of_loops(points: np.ndarray, wanted: int) -> None:
    count = min(wanted, len(points) - 1)
    numbers, lengths = nearest_points(points, count)
    expected = literal(points, count)
    np.testing.assert_allclose(lengths, expected[1], rtol=1e-12)
    # Distances that differ by rounding alone may be in another order.
    assert (numbers != np.arange(len(points))[:, None]).all()
    own = np.sqrt(((points[numbers] - points[:, None]) ** 2).sum(2))
    np.testing.assert_allclose(own, expected[1], rtol=1e-12)
    assert (np.diff(np.sort(numbers, 1), axis=1) > 0).all()
    np.testing.assert_allclose(neighbours.plain_nearest_points(points, count)[1], expected[1], rtol=1e-12)


@needs_native
def test_of_equals_the_lower_number_comes_first() -> None:
    grid = np.stack(np.meshgrid(*[np.arange(9.0)] * 3, indexing="ij"), -1).reshape(-1, 3)
    for points in (grid, np.zeros((100, 3))):
        numbers, lengths = nearest_points(points, 8)
        expected = literal(points, 8)
        np.testing.assert_array_equal(numbers, expected[0])
        np.testing.assert_array_equal(lengths, expected[1])


@needs_native
@settings(max_examples=examples(30))
@given(some_points(), st.integers(1, 8), st.floats(0, 5))
def test_parts_are_those_of_scipy(points: np.ndarray, wanted: int, factor: float) -> None:
    count = min(wanted, len(points) - 1)
    numbers, lengths = nearest_points(points, count)
    longest = factor * float(np.median(lengths)) if count else 1.0
    parts = linked_parts(numbers, lengths, longest)
    np.testing.assert_array_equal(parts, neighbours.plain_linked_parts(numbers, lengths, longest))
    first = np.unique(parts, return_index=True)[1]
    assert (np.diff(first) > 0).all()


@needs_native
def test_the_same_for_any_number_of_threads() -> None:
    points, found = np.random.default_rng(0).normal(size=(30_000, 3)), []
    for count in (1, 3):
        with threads_of_torch(count):
            found.append(nearest_points(points, 5))
    for one, other in zip(*found, strict=True):
        np.testing.assert_array_equal(one, other)


@needs_native
def test_bad_arguments_are_refused() -> None:
    core = native_core()
    assert core is not None
    for function, arguments, said in (
        (core.nearest_points, (np.full((3, 3), np.nan), 1, 1), "finite"),
        (core.nearest_points, (np.zeros((3, 3)), 3, 1), "more points"),
        (core.linked_parts, (np.array([[7], [0]]), np.zeros((2, 1)), 1.0), "no point"),
    ):
        with pytest.raises(ValueError, match=said):
            function(*arguments)
