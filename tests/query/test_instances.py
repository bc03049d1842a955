"""Counts of instances, on planted tables of things."""

from __future__ import annotations

from itertools import pairwise

import pytest
import torch

from query.planted_room import Box, planted_room
from scoup.query.matching import ComparedTable, find_instances
from scoup.scene.things import NO_THING
from support import things_of

DIM = 16


def ranges(*sizes: int) -> list[list[int]]:
    """Gaussians of things that follow each other."""
    ends = torch.tensor([0, *sizes]).cumsum(0).tolist()
    return [list(range(start, end)) for start, end in pairwise(ends)]


SINGLE = ranges(*[20] * 9)
OTHERS = [-5.0, -5.5, -6.0, -4.5, -5.0, -5.2]
"""Fits of six other things, of looks 1 to 6."""
REST = [1, 2, 3, 4, 5, 6]


@pytest.mark.parametrize(
    ("owners", "looks", "fits", "chosen", "found"),
    [
        pytest.param(SINGLE, [0, 0, 0, *REST], [3.0, 3.4, 2.8, *OTHERS], [1], [1, 0, 2], id="three separate things"),
        pytest.param(SINGLE, [0, 0, 7, *REST], [3.4, 3.0, 3.3, *OTHERS], [0, 2, 1], [0, 1], id="another look"),
        pytest.param(SINGLE, [0, 0, 0, *REST], [3.4, 3.0, 0.5, *OTHERS], [0, 1, 2], [0, 1], id="a poor fit"),
        # Three books of a stack, two of which fit alike, and the stack, which answers.
        pytest.param([*SINGLE, list(range(60))], [0, 0, 7, *REST, 0], [3.2, 3.3, 3.1, *OTHERS, 3.4], [9], [9],
                     id="a stack"),
        # The handle and the body of a mug, which answers as a whole.
        pytest.param([*ranges(30, 20, *[20] * 6), list(range(50))], [7, 0, *REST, 0], [1.0, 0.5, *OTHERS, 3.4], [8],
                     [8], id="parts that fit less"),
        pytest.param([*SINGLE[:7], SINGLE[0]], [0, *REST, 7], [3.4, *OTHERS, 1.0], [7], [7],
                     id="the best is of another level"),
    ],
)  # fmt: skip
def test_instances_are_what_looks_and_fits_like_the_answer(
    owners: list[list[int]], looks: list[int], fits: list[float], chosen: list[int], found: list[int]
) -> None:
    """``owners`` lists each thing's Gaussians: those beyond single ones, which come first, are of level 1. ``looks``
    are axes of embeddings."""
    levels = [
        int(bool(thing) and gaussians[0] <= owners[thing - 1][-1]) for thing, gaussians in enumerate(owners)
    ]
    own = torch.full((1 + max(map(max, owners)), 1 + max(levels)), NO_THING)
    for thing, (gaussians, level) in enumerate(zip(owners, levels, strict=True)):
        own[gaussians, level] = thing
    table = things_of(own, torch.tensor(levels), torch.eye(DIM)[looks])
    compared = ComparedTable.of(table, torch.eye(DIM))
    assert find_instances(compared, torch.tensor(fits), torch.tensor(chosen)).tolist() == found


@pytest.mark.parametrize("count", [1, 2, 5, 9])
def test_things_that_are_all_the_same_are_instances(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("query.planted_room.CLUTTER", ())
    room = planted_room([Box("mug", (1.0 * place, 0, 1), (0.3, 0.3, 0.3)) for place in range(count)])
    assert len(room.things("how many mug")) == count


def test_things_that_are_not_there_do_not_count() -> None:
    """The best one lacks all of its Gaussians."""
    own = torch.arange(20, 180)[:, None] // 20
    table = things_of(own, torch.zeros(9), torch.eye(DIM)[[7, 0, 0, *REST]])
    compared, fits = ComparedTable.of(table, torch.eye(DIM)), torch.tensor([9.0, 3.0, 2.9, *OTHERS])
    assert find_instances(compared, fits, torch.tensor([1])).tolist() == [1, 2]
