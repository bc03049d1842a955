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
from scoup.query.presets import QUERY_PRESETS, QueryPreset
from scoup.query.segment import LevelMasks, choose_level, level_masks, main_parts, mask_box, segment
from support import examples


def literal_segment(
    relevancy: np.ndarray, preset: QueryPreset, thresholds: list[float], instability: list[float]
) -> tuple[np.ndarray, int, float]:
    answers = []
    for level, (image, threshold) in enumerate(zip(relevancy.astype(np.float64), thresholds, strict=True)):
        smoothed = 0.5 * (image + literal_box_mean(image, preset.kernel, preset.border))
        stretched = (smoothed - smoothed.min()) / (smoothed.max() - smoothed.min() + 1e-9)
        mask = np.clip(2 * stretched - 1, 0, 1) > threshold
        if preset.smoothing_border == "but last":
            mask = langsplat_smooth(mask)
        else:
            mask = literal_box_mean(mask.astype(np.float64), preset.smoothing, "inside") > 0.5
        answers.append((mask, level, smoothed.max(), smoothed[mask].mean() if mask.any() else -np.inf))
    evidence = []
    for mask, level, peak, inside in answers:
        if preset.level_choice == "evidence":
            smaller = [other for other, *_ in answers if 0 < other.sum() < mask.sum()]
            held = max(((other & mask).sum() / other.sum() for other in smaller), default=0)
            inside += -0.08 * np.log(max(instability[level], 0.005)) + 0.05 * held
        evidence.append(peak if preset.level_choice == "peak" else inside)
    if not any(mask.any() for mask, *_ in answers):
        evidence = [peak for _, _, peak, _ in answers]
    mask, level, peak, _ = answers[int(np.argmax(evidence))]  # the first of equals
    return mask, level, peak


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
    mask, level, score = literal_segment(
        relevancy.numpy(), preset, thresholds, of_levels.instability.tolist()
    )
    found = segment(relevancy, preset)
    assert found.threshold == thresholds[level]
    assert found.level == level
    assert found.score == pytest.approx(score, abs=1e-6)
    assert float((found.mask.numpy() != mask).mean()) == 0
    assert found.coverage == pytest.approx(mask.mean())
    rows, columns = np.nonzero(mask)
    expected = (columns.min(), rows.min(), columns.max() + 1, rows.max() + 1) if mask.any() else None
    assert mask_box(found.mask) == expected


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


def test_levels_with_empty_masks_answer_only_if_all_are_empty() -> None:
    relevancy = two_levels()
    relevancy[0] = 0.5
    relevancy[0, 10, 10] = 1.0  # the majority of 7 x 7 pixels removes so small a mask
    found = level_masks(relevancy, QUERY_PRESETS["default"])
    assert [bool(mask.any()) for mask in found.masks] == [False, True]
    assert choose_level(found, "mask") == 1
    nothing = torch.full((3, 20, 20), 0.5)
    nothing[1:, 10, 10] = 1.0
    found = segment(nothing, QUERY_PRESETS["default"])
    assert (found.level, mask_box(found.mask)) == (1, None)


@pytest.mark.parametrize("choice", ["peak", "mask", "evidence"])
def test_the_first_of_equal_levels_answers(choice) -> None:
    relevancy = two_levels()[[1, 1, 1]]
    assert choose_level(level_masks(relevancy, QUERY_PRESETS["scoup"]), choice) == 0
    masks = torch.zeros(2, 4, 4, dtype=torch.bool)
    masks[0, 0, :3] = masks[1] = True
    masks = masks if choice != "evidence" else masks[[1, 1]]  # by which the whole wins
    # Means of different areas may be equal too.
    assert (
        choose_level(
            LevelMasks(torch.full((2, 4, 4), 0.1), masks, torch.full((2,), 0.6), torch.zeros(2)), choice
        )
        == 0
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


def nested_levels(part: float, whole: float) -> torch.Tensor:
    """A part at the first level, and at the second the whole that holds it, with the relevancy given."""
    relevancy = torch.full((2, 60, 90), 0.3)
    relevancy[0, 22:34, 35:47] = part
    relevancy[1, 20:45, 30:70] = whole
    return relevancy


def test_a_whole_that_holds_the_answer_of_another_level_is_preferred_by_evidence() -> None:
    found = level_masks(nested_levels(0.60, 0.58), QUERY_PRESETS["default"])
    assert choose_level(found, "mask") == 0
    assert choose_level(found, "evidence") == 1
    # But not one that is much less relevant.
    far = level_masks(nested_levels(0.75, 0.55), QUERY_PRESETS["default"])
    assert choose_level(far, "evidence") == 0
    # Nor one that lies elsewhere.
    apart = nested_levels(0.60, 0.58)
    apart[0] = apart[0].roll(shifts=(24, 40), dims=(0, 1))
    assert choose_level(level_masks(apart, QUERY_PRESETS["default"]), "evidence") == 0


def test_a_stable_mask_is_preferred_by_evidence() -> None:
    y, x = torch.meshgrid(torch.arange(60.0), torch.arange(90.0), indexing="ij")
    relevancy = torch.full((2, 60, 90), 0.3)
    relevancy[0] += 0.3 * torch.exp(-((x - 25) ** 2 + (y - 30) ** 2) / 300)  # fades away
    relevancy[1, 25:40, 65:85] = 0.55
    found = level_masks(relevancy, QUERY_PRESETS["default"])
    assert found.instability[0] > 0.15 > 0.05 > found.instability[1]
    means = [float(level[mask].mean()) for level, mask in zip(found.smoothed, found.masks, strict=True)]
    assert means[0] > means[1]
    assert (choose_level(found, "mask"), choose_level(found, "evidence")) == (0, 1)
