"""Segmentation against literal loops and hand-made cases."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from evaluate.literal import langsplat_smooth
from query.box_means import literal_box_mean
from scoup.base.errors import InputError
from scoup.query.localize import localize
from scoup.query.presets import QUERY_PRESETS, LevelChoice, QueryPreset
from scoup.query.segment import LevelMasks, choose_level, level_masks, main_parts, mask_box, segment
from support import examples


def literal_level(smoothed: np.ndarray, masks: np.ndarray, instability: list[float], choice: str) -> int:
    peaks = [level.max() for level in smoothed]
    if choice == "peak" or not masks.any():
        return int(np.argmax(peaks))  # the first of equals
    evidence = []
    for level, mask, change in zip(smoothed, masks, instability, strict=True):
        found = level[mask].mean() if mask.any() else -np.inf
        if choice == "evidence":
            smaller = [other for other in masks if 0 < other.sum() < mask.sum()]
            held = max(((other & mask).sum() / other.sum() for other in smaller), default=0)
            found += -0.08 * np.log(max(change, 0.005)) + 0.05 * held
        evidence.append(found)
    return int(np.argmax(evidence))


def literal_masks(
    relevancy: np.ndarray, preset: QueryPreset, thresholds: list[float]
) -> tuple[np.ndarray, np.ndarray]:
    smoothed, masks = [], []
    for image, threshold in zip(relevancy.astype(np.float64), thresholds, strict=True):
        level = 0.5 * (image + literal_box_mean(image, preset.kernel, preset.border))
        stretched = (level - level.min()) / (level.max() - level.min() + 1e-9)
        mask = np.clip(2 * stretched - 1, 0, 1) > threshold
        if preset.smoothing_border == "but last":
            mask = langsplat_smooth(mask)
        else:
            mask = literal_box_mean(mask.astype(np.float64), preset.smoothing, "inside") > 0.5
        smoothed.append(level)
        masks.append(mask)
    return np.stack(smoothed), np.stack(masks)


shapes = st.tuples(st.integers(1, 11), st.integers(1, 11))


@settings(max_examples=examples(40))
@given(shapes, st.sampled_from(list(QUERY_PRESETS)), st.integers(1, 3), st.integers(0, 2**31))
def test_segment_equals_the_protocol_read_literally(
    shape: tuple[int, int], name: str, levels: int, seed: int
) -> None:
    # Coarse values, so that nothing lies within rounding of the threshold by chance of float32.
    relevancy = torch.randint(0, 256, (levels, *shape), generator=torch.Generator().manual_seed(seed)) / 256
    preset = QUERY_PRESETS[name]
    # The most stable ones have a literal reading of their own, in test_stable_threshold.py.
    of_levels = level_masks(relevancy, preset)
    thresholds = of_levels.thresholds.tolist()
    if preset.threshold is not None:
        assert thresholds == pytest.approx([preset.threshold] * levels)
    smoothed, masks = literal_masks(relevancy.numpy(), preset, thresholds)
    level = literal_level(smoothed, masks, of_levels.instability.tolist(), preset.level_choice)
    mask, score = masks[level], smoothed[level].max()
    found = segment(relevancy, preset)
    assert found.threshold == thresholds[level]
    assert found.level == level
    assert found.score == pytest.approx(score, abs=1e-6)
    assert float((found.mask.numpy() != mask).mean()) == 0
    assert found.coverage == pytest.approx(mask.mean())
    rows, columns = np.nonzero(mask)
    expected = (columns.min(), rows.min(), columns.max() + 1, rows.max() + 1) if mask.any() else None
    assert mask_box(found.mask) == expected


@settings(max_examples=examples(4000))
@given(
    st.sampled_from([1, 2, 4, 4]), st.sampled_from(["peak", "mask", "evidence", "evidence"]), st.integers(0, 2**31)
)  # fmt: skip
def test_the_level_that_answers_read_literally(levels: int, choice: LevelChoice, seed: int) -> None:
    """Of levels that are almost equally relevant; masks are rectangles: some or all empty, equal, nested."""
    random = np.random.default_rng(seed)
    smoothed = 0.5 + random.integers(0, 6, (levels, 6, 8)).astype(np.float32) / 64
    masks = np.zeros((levels, 6, 8), bool)
    for mask in masks:
        top, left, height, width = random.integers(0, (3, 4, 4, 5))
        mask[top : top + height, left : left + width] = True
    masks[:] &= random.random() < 0.9
    instability = (10 ** random.uniform(-3, 0.5, levels)).astype(np.float32)
    if random.random() < 0.1:
        smoothed[:], masks[:], instability[:] = smoothed[0], masks[0], instability[0]
    found = LevelMasks(*map(torch.from_numpy, (smoothed, masks, instability, instability)))
    expected = literal_level(smoothed.astype(np.float64), masks, instability.tolist(), choice)
    assert choose_level(found, choice) == expected


def test_segment_finds_a_square_at_the_level_that_shows_it() -> None:
    relevancy = torch.full((3, 60, 80), 0.5)
    relevancy[1, 20:40, 30:60] = 0.9
    relevancy[2, 5:30, 5:30] = 0.8
    found = segment(relevancy)
    # At a straight edge the box is 4, 5 and 6 sevenths inside: rescaled, the first three rows of the square have 0.571,
    # 0.714 and 0.857, and no pixel lies between 0.735 and 0.857. There the area does not change at all.
    assert found.threshold == pytest.approx(0.79)
    assert (found.level, mask_box(found.mask)) == (1, (32, 22, 58, 38))
    assert found.mask[24:36, 34:56].all()
    assert found.coverage == pytest.approx(16 * 26 / (60 * 80), rel=0.06)
    fixed = segment(relevancy, QUERY_PRESETS["scoup"])  # 0.571 is just below its threshold
    assert (fixed.level, mask_box(fixed.mask)) == (1, (31, 21, 59, 39))
    assert fixed.coverage == pytest.approx(18 * 28 / (60 * 80), rel=0.06)


def two_levels() -> Tensor:
    """A small spot of high relevancy at the first level, a large square a little lower at the second."""
    relevancy = torch.full((2, 60, 80), 0.5)
    relevancy[0, 20:40, 30:60] = 0.84
    relevancy[0, 27:34, 40:47] = 0.92  # its mask is wider than the spot, and lower on average
    relevancy[1, 20:40, 30:60] = 0.88
    return relevancy


def test_the_level_by_its_peak_or_by_its_mask() -> None:
    relevancy = two_levels()
    by_peak, by_mask = (
        segment(relevancy, QUERY_PRESETS["scoup"]),
        segment(relevancy, QUERY_PRESETS["default"]),
    )
    assert (by_peak.level, by_mask.level, segment(relevancy).level) == (0, 1, 1)
    found = level_masks(relevancy, QUERY_PRESETS["default"])
    means = [float(level[mask].mean()) for level, mask in zip(found.smoothed, found.masks, strict=True)]
    assert means == pytest.approx([0.845, 0.87], abs=0.01)
    assert by_mask.mask.equal(found.masks[1])
    assert by_mask.smoothed.equal(found.smoothed[1])
    assert by_mask.threshold == float(found.thresholds[1])
    # The score is the largest smoothed relevancy of the level chosen, by either rule.
    assert by_mask.score == pytest.approx(0.88)
    assert by_peak.score == pytest.approx(float(found.smoothed[0].max()))
    assert (
        localize(relevancy, QUERY_PRESETS["default"]).level
        == localize(relevancy, QUERY_PRESETS["scoup"]).level
    )


def test_constant_maps_give_empty_masks_and_every_pixel_as_maximum() -> None:
    relevancy = torch.full((2, 9, 15), 0.5)
    found = segment(relevancy)
    assert (found.level, mask_box(found.mask), found.coverage) == (0, None, 0.0)
    assert found.score == pytest.approx(0.5)
    place = localize(relevancy)
    assert len(place.pixels) == 9 * 15
    assert place.pixel == (7, 4)
    assert place.level == 0


@pytest.mark.parametrize("preset", QUERY_PRESETS.values(), ids=QUERY_PRESETS)
def test_one_pixel(preset: QueryPreset) -> None:
    place = localize(torch.tensor([[[0.4]], [[0.6]]]), preset)
    assert (place.pixel, place.level, place.pixels.tolist()) == ((0, 0), 1, [[0, 0]])
    assert place.score == pytest.approx(0.6)
    assert segment(torch.tensor([[[0.4]]]), preset).mask.tolist() == [[False]]


@pytest.mark.parametrize("shape", [(3, 4), (0, 3, 4), (2, 0, 4), (1, 2, 3, 4)])
def test_shapes_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(InputError):
        localize(torch.zeros(shape))
    with pytest.raises(InputError):
        segment(torch.zeros(shape))


def test_the_core_is_the_more_relevant_half_of_the_mask() -> None:
    maps = torch.full((2, 24, 30), 0.4)
    maps[1, 4:14, 6:20] = torch.linspace(0.7, 0.9, 14)
    found = segment(maps)
    mask, core = found.mask, found.core()
    assert found.level == 1
    assert bool((core & ~mask).any()) is False
    assert 0.4 < int(core.sum()) / int(mask.sum()) < 0.7
    columns = core.nonzero()[:, 1].float()
    assert columns.mean() > mask.nonzero()[:, 1].float().mean()


def test_an_empty_mask_gives_the_peak() -> None:
    found = segment(torch.full((3, 9, 9), 0.5))
    assert (found.level, int(found.core().sum())) == (0, 81)


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
@given(shapes, st.integers(0, 2**31))
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
