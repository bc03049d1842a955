"""Positions and oriented boxes of things made for it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from query.conftest import ASKED
from scoup.base import WorldFrame
from scoup.query.answer import Answer
from scoup.query.boxes import OrientedBox, PointSets
from scoup.query.things import MOST_LINKED, Place, Thing, connected_parts, place_of, rough_parts
from scoup.scene import Gaussians
from support import examples, gaussians_at, unit

UP = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)


@dataclass
class Placed:
    """As much of a field as ``place_of`` looks at."""

    gaussians: Gaussians
    relevancy: Tensor  # [N] of its only level
    thing_table: None = None
    world: WorldFrame = field(default_factory=WorldFrame)

    def up(self) -> Tensor:
        return UP

    def gaussian_relevancy(self, queries: Tensor, canonical: Tensor) -> Tensor:
        return self.relevancy[None, None]


def located(means: Tensor, relevancy: Tensor | float = 0.8, opacities: Tensor | float = 0.8) -> Place:
    ones = torch.ones(len(means))
    field: Any = Placed(replace(gaussians_at(means), opacities=opacities * ones), relevancy * ones)
    return place_of(field, Answer("thing", ones.bool(), "m", None, ASKED))


def block(count: int, size: list[float], seed: int = 0) -> Tensor:
    random = torch.Generator().manual_seed(seed)
    return (torch.rand(count, 3, generator=random, dtype=torch.float64) - 0.5) * torch.tensor(size)


def turned(angle: float) -> Tensor:
    c, s = math.cos(angle), math.sin(angle)
    return torch.tensor([[c, -s, 0], [s, c, 0], [0, 0, 1.0]], dtype=torch.float64)


def box_of(points: Tensor, up: Tensor = UP) -> OrientedBox:
    (box,) = PointSets.of_one_thing(points, torch.ones(len(points), dtype=torch.float64)).boxes(up)
    assert box is not None
    return box


def found_place(means: Tensor, **given: Tensor) -> tuple[Place, Tensor, OrientedBox, Thing]:
    """The place of what is there, its position, box and thing."""
    place = located(means, **given)
    assert place.position is not None
    assert place.box is not None
    assert place.thing is not None
    return place, place.position, place.box, place.thing


def test_a_turned_block_is_found_where_it_is() -> None:
    centre = torch.tensor([3.0, -2.0, 5.0], dtype=torch.float64)
    turn, size = turned(0.6), torch.tensor([2.0, 1.0, 0.5], dtype=torch.float64)
    found, position, box, thing = found_place(block(4000, size.tolist()) @ turn.T + centre)
    assert (position - centre).norm() < 0.1
    assert (box.centre - centre).norm() < 0.1
    torch.testing.assert_close(box.extent, size, atol=0.1, rtol=0)
    assert abs(float(box.axes[0] @ turn[:, 0])) > 0.99
    assert box.axes[2].tolist() == [0, 0, 1]  # without cameras, +z is up
    assert (thing.n_gaussians, thing.text, thing.number) == (4000, ASKED.word, None)
    torch.testing.assert_close(box.corners().mean(0), box.centre)
    assert found.to_dict()["box"]["extent"] == pytest.approx(box.extent.tolist(), rel=1e-4)


@pytest.mark.parametrize("up", [(0.0, 0, 1), (0.0, -1, 0), (0.6, 0.0, -0.8)])
def test_boxes_stand_upright_with_the_longer_side_first(up: tuple[float, float, float]) -> None:
    """A tall block, turned about up: its principal axes in space say nothing, for it is lopsided."""
    axis = torch.tensor(up, dtype=torch.float64)
    side = unit(torch.linalg.cross(axis, torch.tensor([0.3, 0.5, 0.1], dtype=torch.float64)))
    frame = torch.stack([side, torch.linalg.cross(axis, side), axis])
    points = block(4000, [1.0, 1.5, 4.0])
    points[:, 1] *= 0.5 + points[:, 2].abs() / 4  # wider at both ends
    box = box_of(points @ frame, axis)
    torch.testing.assert_close(box.axes[2], axis)
    assert abs(float(box.axes[0] @ frame[1])) > 0.98
    assert float(torch.linalg.det(box.axes)) == pytest.approx(1)
    torch.testing.assert_close(box.extent, torch.tensor([1.3, 1.0, 3.92]).double(), atol=0.1, rtol=0)


def test_a_square_box_lies_along_its_sides() -> None:
    """The principal axes of a square are arbitrary; along its sides the box is half as large as along diagonals."""
    for degrees in range(0, 90, 15):
        points = block(3000, [1.0, 1.0, 0.2]) @ turned(math.radians(degrees)).T
        assert float(box_of(points).extent[:2].prod()) < 1.3


def test_strays_do_not_move_it() -> None:
    thing, strays = block(500, [1.0, 1.0, 1.0]), block(60, [80.0, 80.0, 80.0], seed=1)
    _, alone, small, _ = found_place(thing)
    _, position, box, found = found_place(torch.cat([strays, thing]))
    assert (position - alone).norm() < 0.1
    assert box.extent.max() < 1.3 * small.extent.max()
    assert int((found.gaussians < 60).sum()) <= 1


@pytest.mark.parametrize(
    ("relevancies", "opacities", "position"),
    [((0.8, 0.8), (0.8, 0.8), 10), ((0.8, 0.8), (0.9, 0.1), 0), ((0.8, 0.5), (0.8, 0.8), 0),
     ((0.6, 0.5), (0.8, 0.8), 10)],
    ids=["more", "more opaque", "more relevant, 80 against 75", "60 against 75"],
)  # fmt: skip
def test_the_heaviest_thing_is_meant(relevancies, opacities, position: float) -> None:
    counts = torch.tensor([100, 150])
    few, many = block(100, [1.0] * 3), block(150, [1.0] * 3, seed=1) + 10
    relevancy, opacity = (
        torch.tensor(values).repeat_interleave(counts) for values in (relevancies, opacities)
    )
    _, found, _, _ = found_place(torch.cat([few, many]), relevancy=relevancy, opacities=opacity)
    assert float(found[0]) == pytest.approx(position, abs=0.3)


def test_what_has_no_place() -> None:
    nan = torch.full((4, 3), torch.nan)
    for found in (located(nan[:0]), located(nan), located(torch.ones(5, 3), opacities=0.0)):
        assert (found.thing, found.position, found.box, found.presence) == (None, None, None, False)
        assert found.to_dict()["position"] is None


@pytest.mark.parametrize("count", [1, 2, 3, 20])
def test_a_few_gaussians_at_one_place_make_a_box_without_extent(count: int) -> None:
    found, position, box, _ = found_place(torch.full((count, 3), 2.5))
    assert found.presence
    assert position.tolist() == [2.5, 2.5, 2.5]
    assert float(box.extent.abs().max()) < 1e-6
    assert torch.isfinite(box.axes).all()


@settings(max_examples=examples(60))
@given(st.integers(1, 40), st.integers(0, 2**31), st.sampled_from([1e-6, 1.0, 1e6]))
def test_boxes_hold_their_points(count: int, seed: int, scale: float) -> None:
    random = torch.Generator().manual_seed(seed)
    points = torch.randn(count, 3, generator=random, dtype=torch.float64) * scale
    box = box_of(points)
    torch.testing.assert_close(box.axes @ box.axes.T, torch.eye(3, dtype=torch.float64), atol=1e-9, rtol=0)
    along = ((points - box.centre) @ box.axes.T).abs()
    assert (along <= box.extent / 2 + 1e-9 * scale).all()  # fewer than 50 points: none may be cut off


@settings(max_examples=examples(60))
@given(
    st.lists(st.integers(0, 700), min_size=1, max_size=4),
    st.integers(0, 2**31),
    st.sampled_from([0.0, 1e-300, 1.0, 1e300]),
    st.booleans(),
)
def test_quantiles_are_of_sorted_values(sizes: list[int], seed: int, scale: float, strays: bool) -> None:
    random = np.random.default_rng(seed)
    starts = np.concatenate([[0], np.cumsum(sizes)])
    values = random.standard_normal((starts[-1], 3)) * scale
    if strays:
        values[:1] *= 1e6  # all others are in one bin
    weights = random.integers(0, 4, starts[-1]).astype(np.float64)  # sums are exact
    weights[starts[:-1][np.array(sizes) > 0]] += 1
    shares = [0.0, 0.02, 0.5, 1.0]
    points = PointSets(values, weights, starts)
    found = points.quantiles(shares)
    assert np.array_equal(
        points.quantiles(shares, np.tile(np.eye(3), (len(sizes), 1, 1))), found, equal_nan=True
    )
    for thing, (first, last) in enumerate(pairwise(starts)):
        for axis in range(3):
            if first == last:
                assert np.isnan(found[thing, axis]).all()
                continue
            order = np.argsort(values[first:last, axis])
            sums = weights[first:last][order].cumsum()
            at = np.searchsorted(sums, np.multiply(shares, sums[-1]))
            assert found[thing, axis].tolist() == values[first + order[at], axis].tolist()


def test_many_points_are_linked_cell_by_cell() -> None:
    few = block(MOST_LINKED, [1.0] * 3).numpy()
    assert (rough_parts(few) == connected_parts(few)).all()
    two = torch.cat([block(50, [1.0] * 3), block(50, [1.0] * 3, seed=1) + 30]).numpy()
    assert connected_parts(two).tolist() == [0] * 50 + [1] * 50
    assert connected_parts(two[:1]).tolist() == [0]
    near, far = block(3 * MOST_LINKED, [2.0, 1.0, 0.01]), block(2 * MOST_LINKED, [1.0] * 3, seed=1) + 5
    parts = rough_parts(torch.cat([near, far, torch.full((1, 3), 3.0)]).numpy())
    own = np.split(parts, [len(near), len(near) + len(far)])
    assert [np.unique(each).size for each in own] == [1, 1, 1]
    assert np.unique(parts).size == 3
    assert (rough_parts(np.ones((MOST_LINKED + 1, 3))) == 0).all()
