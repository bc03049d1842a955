"""Points and masks of relevancy maps against literal loops and hand-made cases."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from evaluate import literal
from scoup.base import InputError
from scoup_lab.evaluate.relevancy_maps import box_mean, choose_level, localize, segment
from scoup_lab.evaluate.rules import MASK_RULES, Border, LevelChoice, MaskRule
from support import examples

SCOUP = MASK_RULES["scoup"]
BY_MASK = MaskRule("by mask", 7, "inside", 0.6, 7, "mask")
RULES = pytest.mark.parametrize("rule", MASK_RULES.values(), ids=MASK_RULES)
shapes = st.tuples(st.integers(1, 11), st.integers(1, 11))


def literal_level(smoothed: np.ndarray, masks: np.ndarray, choice: LevelChoice) -> int:
    if choice == "peak" or not masks.any():
        return int(np.argmax([level.max() for level in smoothed]))  # the first of equals
    means = [
        level[mask].mean() if mask.any() else -np.inf for level, mask in zip(smoothed, masks, strict=True)
    ]
    return int(np.argmax(means))


@settings(max_examples=examples(40))
@given(shapes, st.sampled_from([*MASK_RULES.values(), BY_MASK]), st.integers(1, 3), st.integers(0, 2**31))
def test_segment_equals_the_protocol_read_literally(
    shape: tuple[int, int], rule: MaskRule, levels: int, seed: int
) -> None:
    # Coarse values, so that nothing lies within rounding of the threshold by chance of float32.
    relevancy = torch.randint(0, 256, (levels, *shape), generator=torch.Generator().manual_seed(seed)) / 256
    constants = rule.kernel, rule.border, rule.threshold, rule.smoothing, rule.smoothing_border
    smoothed, masks = literal.masks(relevancy.numpy(), *constants)
    level = literal_level(smoothed, masks, rule.level_choice)
    found = segment(relevancy, rule)
    assert found.level == level
    assert found.score == pytest.approx(smoothed[level].max(), abs=1e-6)
    np.testing.assert_array_equal(found.mask.numpy(), masks[level])


@settings(max_examples=examples(1000))
@given(st.sampled_from([1, 2, 4, 4]), st.sampled_from(["peak", "mask"]), st.integers(0, 2**31))
def test_the_level_that_answers_read_literally(levels: int, choice: LevelChoice, seed: int) -> None:
    """Of levels that are almost equally relevant; masks are rectangles: some or all empty, equal, nested."""
    random = np.random.default_rng(seed)
    smoothed = 0.5 + random.integers(0, 6, (levels, 6, 8)).astype(np.float32) / 64
    masks = np.zeros((levels, 6, 8), bool)
    for mask in masks:
        top, left, height, width = random.integers(0, (3, 4, 4, 5))
        mask[top : top + height, left : left + width] = True
    masks[:] &= random.random() < 0.9
    if random.random() < 0.1:
        smoothed[:], masks[:] = smoothed[0], masks[0]
    found = choose_level(torch.from_numpy(smoothed), torch.from_numpy(masks), choice)
    assert found == literal_level(smoothed.astype(np.float64), masks, choice)


def test_localize_by_hand() -> None:
    relevancy = torch.zeros(3, 20, 30)
    relevancy[0, 3, 4] = 1.0  # a spike: large, but averaged away
    relevancy[2, 10:17, 15:22] = 0.8
    place = localize(relevancy, SCOUP)
    assert (place.pixel, place.level) == ((18, 13), 2)
    assert place.score == pytest.approx(0.8)
    assert place.pixels.tolist() == [[18, 13]]


def test_ties_are_all_reported_row_by_row_and_the_first_level_wins() -> None:
    relevancy = torch.zeros(2, 20, 40)
    relevancy[0, 10, 10] = relevancy[0, 10, 30] = relevancy[1, 5, 5] = 1.0
    place = localize(relevancy, MaskRule("one", kernel=1, border="inside", threshold=0.6, smoothing=1))
    assert place.pixels.tolist() == [[10, 10], [30, 10]]
    assert place.level == 0
    assert place.pixel in [(10, 10), (30, 10)]


def test_constant_maps_give_empty_masks_and_every_pixel_as_maximum() -> None:
    relevancy = torch.full((2, 9, 15), 0.5)
    found = segment(relevancy, SCOUP)
    assert (found.level, bool(found.mask.any())) == (0, False)
    assert found.score == pytest.approx(0.5)
    place = localize(relevancy, SCOUP)
    assert len(place.pixels) == 9 * 15
    assert (place.pixel, place.level) == ((7, 4), 0)


@pytest.mark.parametrize("shape", [(3, 4), (0, 3, 4), (2, 0, 4), (1, 2, 3, 4)])
def test_shapes_refused(shape: tuple[int, ...]) -> None:
    for work in (localize, segment):
        with pytest.raises(InputError):
            work(torch.zeros(shape), SCOUP)


@settings(max_examples=examples(60))
@given(shapes, st.integers(1, 30), st.sampled_from(["inside", "reflect"]), st.integers(0, 2**31))
def test_box_mean(shape: tuple[int, int], kernel: int, border: Border, seed: int) -> None:
    image = torch.rand(shape, generator=torch.Generator().manual_seed(seed))
    expected = literal.box(image.double().numpy(), kernel, border)
    np.testing.assert_allclose(box_mean(image, kernel, border).numpy(), expected, atol=1e-6)
    np.testing.assert_allclose(box_mean(image.double(), kernel, border).numpy(), expected, atol=1e-12)


@pytest.mark.parametrize("border", ["inside", "reflect"])
@pytest.mark.parametrize("value", [0.1, 0.3, 0.7])
def test_constant_maps_stay_constant(border: Border, value: float) -> None:
    averaged = box_mean(torch.full((300, 417), value), 7, border)
    assert len(averaged.unique()) == 1
