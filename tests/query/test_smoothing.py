"""Box means and masks of the compiled core against the same in torch, to the last bit."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from scoup.base.native import missing_reason, native_core
from scoup.query.localize import averaged_relevancy, localize
from scoup.query.presets import QUERY_PRESETS
from scoup.query.segment import localize_and_segment, segment
from scoup.query.smoothing import (
    box_mean,
    mask_parts,
    mask_sums,
    plain_box_mean,
    plain_mask_parts,
    plain_mask_sums,
    plain_smoothed_masks,
    smoothed_masks,
)
from scoup_lab.bench.measure import torch_threads
from support import examples

needs_core = pytest.mark.skipif(native_core() is None, reason=str(missing_reason()))
shapes = st.tuples(st.integers(1, 3), st.integers(1, 40), st.integers(1, 40))
sides = st.integers(1, 34)
three_thresholds = st.tuples(*[st.floats(0, 1, width=32)] * 3)


MAP = torch.zeros(1, 3, 4)


def random_maps(shape: tuple[int, ...], seed: int, ugly: bool = False) -> Tensor:
    """Smooth, coarse or constant maps in 0..1; ``ugly`` ones hold what is no number."""
    generator = torch.Generator().manual_seed(seed)
    maps = torch.rand(shape, generator=generator)
    kind = seed % 4
    if kind == 1:
        maps = (maps * 8).round() / 8  # many equal ones
    elif kind == 2:
        maps = torch.full(shape, float(maps.flatten()[0]))
    elif kind == 3:
        maps = maps.cumsum(-1) / maps.shape[-1]
    if ugly:
        chosen = torch.rand(shape, generator=generator) < 0.02
        maps[chosen] = torch.tensor([torch.nan, torch.inf, -torch.inf])[seed % 3]
    return maps


def assert_same(found: Tensor, expected: Tensor) -> None:
    assert found.dtype == expected.dtype
    torch.testing.assert_close(found, expected, rtol=0, atol=0, equal_nan=True)


@needs_core
@settings(max_examples=examples(80))
@given(shapes, sides, st.sampled_from(["inside", "reflect"]), st.integers(0, 2**31), st.booleans())
def test_box_means(shape, kernel, border, seed, ugly) -> None:
    maps = random_maps(shape, seed, ugly)
    assert_same(box_mean(maps, kernel, border), plain_box_mean(maps, kernel, border))


@needs_core
@settings(max_examples=examples(80))
@given(shapes, sides, sides, three_thresholds, st.integers(0, 2**31), st.booleans())
def test_masks_and_their_sums(shape, kernel, smoothing, three, seed, ugly) -> None:
    maps = random_maps(shape, seed, ugly)
    thresholds = torch.tensor(three[: len(maps)])
    averaged = box_mean(maps, kernel)
    smoothed, masks = smoothed_masks(maps, averaged, thresholds, smoothing)
    expected = plain_smoothed_masks(maps, averaged, thresholds, smoothing)
    assert_same(smoothed, expected[0])
    assert_same(masks, expected[1])
    peaks, areas, sums = mask_sums(smoothed, masks)
    expected_peaks, expected_areas, expected_sums = plain_mask_sums(smoothed, masks)
    assert_same(peaks, expected_peaks)
    assert_same(areas, expected_areas)
    torch.testing.assert_close(sums, expected_sums, rtol=1e-12, atol=0, equal_nan=True)


@needs_core
@pytest.mark.parametrize("name", ["baseline", "v3", "v4"])
def test_every_instruction_set_says_the_same(name) -> None:
    core = native_core()
    assert core is not None
    if not core.use_isa(name):
        pytest.skip("this CPU or this build has no such instruction set")
    try:
        maps, thresholds = random_maps((3, 61, 47), 4), torch.tensor([0.1, 0.3, 0.0])
        averaged = box_mean(maps, 7)
        smoothed, masks = smoothed_masks(maps, averaged, thresholds, 5)
    finally:
        core.use_isa("best")
    assert_same(averaged, plain_box_mean(maps, 7))
    assert_same(masks, plain_smoothed_masks(maps, averaged, thresholds, 5)[1])
    assert_same(smoothed, 0.5 * (maps + averaged))


@needs_core
def test_threads_and_strides_make_no_difference() -> None:
    maps = random_maps((3, 50, 70), 0)
    with torch_threads(1):
        expected = segment(maps), box_mean(maps, 8, "reflect")
    with torch_threads(3):
        found = segment(maps), box_mean(maps, 8, "reflect")
    assert_same(found[0].mask, expected[0].mask)
    assert_same(found[1], expected[1])
    turned = maps.transpose(1, 2).contiguous().transpose(1, 2)
    assert_same(box_mean(turned, 8, "reflect"), expected[1])
    assert_same(segment(turned).mask, expected[0].mask)
    assert_same(box_mean(maps[0], 5), box_mean(maps, 5)[0])
    assert box_mean(maps[:0], 5).shape == (0, 50, 70)


def test_other_types_take_the_plain_way() -> None:
    maps = random_maps((2, 20, 30), 0)
    assert box_mean(maps.double(), 7).dtype == torch.float64
    assert box_mean(maps, 5000).unique().numel() <= 2  # one mean for all pixels, but for rounding
    assert segment(maps.double()).mask.shape == (20, 30)


@pytest.mark.parametrize("preset", QUERY_PRESETS.values(), ids=QUERY_PRESETS)
def test_both_at_once_is_one_after_the_other(preset) -> None:
    maps = random_maps((3, 40, 60), 0)
    place, shape = localize_and_segment(maps, preset)
    alone, other = localize(maps, preset), segment(maps, preset, averaged_relevancy(maps, preset))
    assert (place.pixel, place.level, place.score) == (alone.pixel, alone.level, alone.score)
    assert_same(place.pixels, alone.pixels)
    assert (shape.level, shape.score, shape.coverage) == (other.level, other.score, other.coverage)
    assert_same(shape.mask, other.mask)


@needs_core
@pytest.mark.parametrize(
    ("name", "arguments", "message"),
    [
        ("box_means", (torch.zeros(3, 4), 7, False), "maps must be"),
        ("box_means", (torch.zeros(1, 3, 4), 0, False), "kernel must be 1 to"),
        ("level_masks", (MAP, torch.zeros(1, 3, 5), torch.zeros(1), 7), "averaged must be"),
        ("level_masks", (MAP, MAP, torch.zeros(2), 7), "thresholds must be"),
        ("level_masks", (MAP, MAP, torch.zeros(1).double(), 7), "thresholds must be"),
        ("level_masks", (MAP, MAP, torch.zeros(1), 10**6), "smoothing must be"),
        ("level_sums", (torch.zeros(1, 3, 4), torch.zeros(1, 3, 4)), "masks must be"),
    ],
)
def test_the_core_refuses_what_does_not_fit(name, arguments, message) -> None:
    arrays = [part.numpy() if isinstance(part, Tensor) else part for part in arguments]
    with pytest.raises(ValueError, match=message):
        getattr(native_core(), name)(*arrays, 1)


@needs_core
@settings(max_examples=examples(60))
@given(st.integers(0, 40), st.integers(0, 40), st.floats(0, 1), st.integers(0, 2**31))
def test_parts_of_a_mask_are_those_of_scipy(height: int, width: int, share: float, seed: int) -> None:
    mask = np.random.default_rng(seed).random((height, width)) < share
    parts, count = mask_parts(mask)
    expected, expected_count = plain_mask_parts(mask)
    assert count == expected_count
    np.testing.assert_array_equal(parts, expected)
