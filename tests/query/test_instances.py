"""Counts of instances, on planted tables of things."""

from __future__ import annotations

from itertools import pairwise

import torch
from torch import Tensor

from scoup.query.matching import ComparedTable, find_instances
from scoup.scene.things import NO_THING, ThingTable

DIM = 16


def _table(owners: list[list[int]], levels: list[int], looks: list[int]) -> ThingTable:
    """``owners`` lists each thing's Gaussians, ``looks`` the axis of its embedding."""
    count, size = len(levels), 1 + max(max(each) for each in owners)
    own = torch.full((size, 1 + max(levels)), NO_THING, dtype=torch.int32)
    for thing, (gaussians, level) in enumerate(zip(owners, levels, strict=True)):
        own[gaussians, level] = thing
    return ThingTable(
        own,
        torch.tensor(levels, dtype=torch.uint8),
        torch.full((count,), NO_THING, dtype=torch.int32),
        torch.eye(DIM)[looks].half(),
        torch.full((count,), 0.9),
        torch.full((count,), 9, dtype=torch.int32),
        torch.ones(count),
        torch.ones(count),
    )


def _instances(table: ThingTable, fits: Tensor, chosen: Tensor) -> list[int]:
    return find_instances(ComparedTable.of(table, torch.eye(DIM)), fits, chosen).tolist()


def _ranges(*sizes: int) -> list[list[int]]:
    """Return Gaussians of things that follow each other."""
    ends = torch.tensor([0, *sizes]).cumsum(0).tolist()
    return [list(range(start, end)) for start, end in pairwise(ends)]


OTHERS = [-5.0, -5.5, -6.0, -4.5, -5.0, -5.2]
"""Fits of six other things, of looks 1 to 6."""


def test_three_separate_things_are_three() -> None:
    table = _table(_ranges(*[20] * 9), [0] * 9, [0, 0, 0, 1, 2, 3, 4, 5, 6])
    found = _instances(table, torch.tensor([3.0, 3.4, 2.8, *OTHERS]), torch.tensor([1]))
    assert found == [1, 0, 2]


def test_an_answer_that_looks_different_is_not_counted() -> None:
    table = _table(_ranges(*[20] * 9), [0] * 9, [0, 0, 7, 1, 2, 3, 4, 5, 6])
    found = _instances(table, torch.tensor([3.4, 3.0, 3.3, *OTHERS]), torch.tensor([0, 2, 1]))
    assert found == [0, 1]


def test_an_answer_that_fits_much_less_is_not_counted() -> None:
    table = _table(_ranges(*[20] * 9), [0] * 9, [0, 0, 0, 1, 2, 3, 4, 5, 6])
    found = _instances(table, torch.tensor([3.4, 3.0, 0.5, *OTHERS]), torch.tensor([0, 1, 2]))
    assert found == [0, 1]


def test_a_stack_is_one_thing() -> None:
    # Three books of a stack, two of which fit alike, and the stack, which answers.
    stack = _ranges(20, 20, 20, *[20] * 6)
    table = _table([*stack, list(range(60))], [0] * 9 + [1], [0, 0, 7, 1, 2, 3, 4, 5, 6, 0])
    found = _instances(table, torch.tensor([3.2, 3.3, 3.1, *OTHERS, 3.4]), torch.tensor([9]))
    assert found == [9]


def test_parts_that_fit_less_are_one_thing() -> None:
    # The handle and the body of a mug, which answers as a whole.
    table = _table([*_ranges(30, 20, *[20] * 6), list(range(50))], [0] * 8 + [1], [7, 0, 1, 2, 3, 4, 5, 6, 0])
    found = _instances(table, torch.tensor([1.0, 0.5, *OTHERS, 3.4]), torch.tensor([8]))
    assert found == [8]


def test_the_answer_counts_where_the_best_thing_is_of_another_level() -> None:
    table = _table([*_ranges(*[20] * 7), list(range(20))], [0] * 7 + [1], [0, 1, 2, 3, 4, 5, 6, 7])
    found = _instances(table, torch.tensor([3.4, *OTHERS, 1.0]), torch.tensor([7]))
    assert found == [7]
