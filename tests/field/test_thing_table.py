"""Things: what is refused, and what they say of themselves."""

from __future__ import annotations

import math
from typing import Any

import pytest
import torch

from messages import refuses
from scoup.field import MOST_THINGS, NO_THING, ThingTable
from scoup.field.thing_table import LEAST_SPREAD, SURE_REGIONS, TENSORS


def parts(**changes: Any) -> dict[str, Any]:
    """Five things: 0 to 2 of level 0, 3 and 4 of level 1; six Gaussians."""
    owners = [[0, 3], [0, 3], [1, 3], [2, NO_THING], [NO_THING, 4], [NO_THING, NO_THING]]
    good = {
        "owners": torch.tensor(owners, dtype=torch.int32),
        "levels": torch.tensor([0, 0, 0, 1, 1], dtype=torch.uint8),
        "parents": torch.tensor([3, 3, NO_THING, NO_THING, NO_THING], dtype=torch.int32),
        "embeddings": torch.eye(5, 8, dtype=torch.float16),
        "agreement": torch.tensor([0.9, 0.8, 0.2, 0.95, 0.1]),
        "n_regions": torch.tensor([3, 4, 2, 9, 2], dtype=torch.int32),
        "mass": torch.tensor([5.0, 3.0, 2.0, 9.0, 1.0]),
        "stability": torch.tensor([0.9, 0.5, 0.1, 1.0, 0.0]),
    }
    return {**good, **changes}


@pytest.fixture
def things() -> ThingTable:
    return ThingTable(**parts())


def test_what_is_whole_is_taken(things: ThingTable) -> None:
    assert tuple(parts()) == TENSORS == tuple(name for name in vars(things) if name != "names")
    assert len(things) == 5
    empty = {name: part[:0] for name, part in parts().items()}
    nothing = ThingTable(**{**empty, "owners": torch.full((6, 2), NO_THING, dtype=torch.int32)})
    assert len(nothing) == 0
    assert not nothing.members(torch.zeros(0, dtype=torch.int64)).any()
    assert nothing.sums(torch.ones(6)).shape == (0,)
    assert nothing.spread == LEAST_SPREAD


def test_values_that_make_no_sense_are_refused() -> None:
    """The rules are those of files (tests/field/test_facts.py), but numbers are int32."""
    for name in ("owners", "parents"):
        with refuses():
            ThingTable(**parts(**{name: parts()[name].to(torch.int64)}))
    for name, place, value in (
        ("owners", (2, 1), 5), ("owners", (2, 1), MOST_THINGS), ("owners", (0, 0), -2), ("parents", 0, 5),
        ("parents", 1, -7), ("levels", 4, 2), ("embeddings", (1, 3), math.nan), ("mass", 0, -math.inf),
    ):  # fmt: skip
        tensor = parts()[name].clone()
        tensor[place] = value
        with refuses():
            ThingTable(**parts(**{name: tensor}))


def test_files_can_number_no_more() -> None:
    def many(count: int) -> ThingTable:
        rows = {name: torch.zeros(count, *part.shape[1:], dtype=part.dtype) for name, part in parts().items()}
        return ThingTable(**parts(**{**rows, "owners": torch.zeros(1, 2, dtype=torch.int32)}))

    assert len(many(MOST_THINGS)) == MOST_THINGS
    with refuses():
        many(MOST_THINGS + 1)


def test_members_are_the_gaussians_of_things_and_sums_are_over_them(things: ThingTable) -> None:
    expected = {(0,): [0, 1], (2, 0): [0, 1, 3], (3,): [0, 1, 2], (4,): [4], (4, 3): [0, 1, 2, 4], (): []}
    for numbers, rows in expected.items():
        found = things.members(torch.tensor(numbers, dtype=torch.int64))
        assert found.nonzero()[:, 0].tolist() == rows
        assert found.dtype == torch.bool
    weights = torch.tensor([1.0, 2.0, 4.0, 8.0, 16.0, 32.0])
    assert things.sums(weights).dtype == torch.float64
    assert things.sums(weights).tolist() == [3, 4, 8, 7, 16]
    assert things.sums(weights > 3).tolist() == [0, 1, 1, 1, 1]
    assert things.rows(torch.tensor([4, 0])).sums(torch.ones(2)).tolist() == [1, 0, 0, 1, 1]


def test_the_spread_is_that_of_the_median_sure_thing(things: ThingTable) -> None:
    """Of the things of three regions or more, which here agree by 0.8, 0.9 and 0.95."""
    assert SURE_REGIONS == 3
    assert things.spread == pytest.approx(math.sqrt((1 - 0.9**2) / 8), abs=1e-6)
    for other in ({"n_regions": torch.full((5,), 2, dtype=torch.int32)}, {"agreement": torch.ones(5)}):
        assert ThingTable(**parts(**other)).spread == LEAST_SPREAD
    assert ThingTable(**parts(agreement=torch.zeros(5))).spread == pytest.approx(8**-0.5)


def test_they_move_between_devices(things: ThingTable) -> None:
    moved = things.to("cpu")
    for name in TENSORS:
        assert getattr(moved, name).equal(getattr(things, name))
