"""The main parts of a mask in a view, and its box."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from scoup.base.native import missing_reason, native_core
from scoup.query.segment import main_parts, mask_box
from scoup.query.smoothing import mask_parts, plain_mask_parts
from support import examples


def test_mask_box() -> None:
    mask = torch.zeros(5, 6, dtype=torch.bool)
    assert mask_box(mask) is None
    mask[4, 5] = True
    assert mask_box(mask) == (5, 4, 6, 5)


@settings(max_examples=examples(40))
@given(st.integers(1, 11), st.integers(1, 11), st.floats(0, 1), st.integers(0, 2**31))
def test_a_box_is_around_all_pixels(height: int, width: int, share: float, seed: int) -> None:
    mask = np.random.default_rng(seed).random((height, width)) < share
    rows, columns = np.nonzero(mask)
    expected = (columns.min(), rows.min(), columns.max() + 1, rows.max() + 1) if mask.any() else None
    assert mask_box(torch.from_numpy(mask)) == expected


def test_the_main_parts_hold_the_point_and_no_specks() -> None:
    mask = torch.zeros(30, 40, dtype=torch.bool)
    mask[10:20, 10:20] = True
    mask[20, 20] = True  # touches at a corner
    mask[2, 35] = mask[28, 1] = True  # specks
    smoothed = torch.where(mask, 0.7, 0.5)
    found = main_parts(mask, (12, 15), smoothed)
    assert mask_box(found) == (10, 10, 21, 21)
    assert int(found.sum()) == 101
    mask[25:28, 30:34] = True  # a piece of 12 pixels: more than a fiftieth
    assert mask_box(main_parts(mask, (12, 15), smoothed)) == (10, 10, 21, 21)  # but its relevancy is only 0.5
    smoothed[26, 31] = 0.65  # a draw is 0.5: 75 % of what the part with the point exceeds it by
    assert mask_box(main_parts(mask, (12, 15), smoothed)) == (10, 10, 21, 21)
    smoothed[26, 31] = 0.67
    assert mask_box(main_parts(mask, (12, 15), smoothed)) == (10, 10, 34, 28)
    assert mask_box(main_parts(mask, (12, 15), smoothed, least_share=0.5)) == (10, 10, 21, 21)
    assert mask_box(main_parts(mask, (35, 2), smoothed, torch.inf)) == (35, 2, 36, 3)
    smoothed[28, 1] = 0.9
    # A point of another level may lie beside the mask: then its most relevant pixel decides.
    assert mask_box(main_parts(mask, (0, 0), smoothed, torch.inf)) == (1, 28, 2, 29)
    assert not main_parts(torch.zeros(3, 4, dtype=torch.bool), (1, 1), torch.zeros(3, 4)).any()


@settings(max_examples=examples(40))
@given(st.tuples(st.integers(1, 11), st.integers(1, 11)), st.integers(0, 2**31))
def test_a_part_is_what_a_flood_reaches(shape: tuple[int, int], seed: int) -> None:
    random = torch.Generator().manual_seed(seed)
    mask = torch.rand(shape, generator=random) < 0.4
    smoothed = torch.rand(shape, generator=random)
    x, y = int(seed % shape[1]), int(seed // 7 % shape[0])
    found = main_parts(mask, (x, y), smoothed, torch.inf)
    if not mask.any():
        assert not found.any()
        return
    if not mask[y, x]:
        y, x = divmod(int(torch.where(mask, smoothed, -1.0).argmax()), shape[1])
    reached, waiting = set(), [(y, x)]
    while waiting:
        row, column = waiting.pop()
        inside = 0 <= row < shape[0] and 0 <= column < shape[1]
        if (row, column) in reached or not inside or not mask[row, column]:
            continue
        reached.add((row, column))
        waiting += [(row + i, column + j) for i in (-1, 0, 1) for j in (-1, 0, 1)]
    assert {tuple(place) for place in found.nonzero().tolist()} == reached


@pytest.mark.skipif(native_core() is None, reason=str(missing_reason()))
@settings(max_examples=examples(60))
@given(st.integers(0, 40), st.integers(0, 40), st.floats(0, 1), st.integers(0, 2**31))
def test_parts_of_a_mask_are_those_of_scipy(height: int, width: int, share: float, seed: int) -> None:
    mask = np.random.default_rng(seed).random((height, width)) < share
    parts, count = mask_parts(mask)
    expected, expected_count = plain_mask_parts(mask)
    assert count == expected_count
    np.testing.assert_array_equal(parts, expected)
