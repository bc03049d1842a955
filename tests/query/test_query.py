"""Localisation, segmentation and 3D selection against literal loops and hand-made cases."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from scoup.base.errors import InputError, UnknownNameError
from scoup.query.answers import (
    DATASET_THRESHOLDS,
    QUERY_PRESETS,
    QueryPreset,
    box_mean,
    choose_level,
    level_masks,
    localize,
    mask_box,
    query_preset,
    rescale,
    segment,
    select,
)
from scoup.query.neighbours import Neighbourhood


def reflect101(position: int, size: int) -> int:
    """cv2.borderInterpolate for BORDER_REFLECT_101, literally."""
    if size == 1:
        return 0
    while not 0 <= position < size:
        position = -position if position < 0 else 2 * (size - 1) - position
    return position


def literal_box_mean(image: np.ndarray, kernel: int, border: str) -> np.ndarray:
    height, width = image.shape
    out = np.zeros((height, width))
    for y in range(height):
        for x in range(width):
            rows = [y + offset - kernel // 2 for offset in range(kernel)]
            columns = [x + offset - kernel // 2 for offset in range(kernel)]
            if border == "reflect":
                rows = [reflect101(row, height) for row in rows]
                columns = [reflect101(column, width) for column in columns]
            else:
                rows = [row for row in rows if 0 <= row < height]
                columns = [column for column in columns if 0 <= column < width]
            out[y, x] = np.mean(image[np.ix_(rows, columns)])
    return out


def literal_segment(relevancy: np.ndarray, preset: QueryPreset) -> tuple[np.ndarray, int, float]:
    answers = []
    for level, image in enumerate(relevancy.astype(np.float64)):
        smoothed = 0.5 * (image + literal_box_mean(image, preset.kernel, preset.border))
        stretched = (smoothed - smoothed.min()) / (smoothed.max() - smoothed.min() + 1e-9)
        mask = np.clip(2 * stretched - 1, 0, 1) > preset.threshold
        mask = literal_box_mean(mask.astype(np.float64), preset.smoothing, "inside") > 0.5
        answers.append((mask, level, smoothed.max(), smoothed[mask].mean() if mask.any() else -np.inf))
    by_mask = preset.level_choice == "mask" and any(mask.any() for mask, *_ in answers)
    mask, level, peak, _ = max(answers, key=lambda answer: answer[3 if by_mask else 2])  # the first of equals
    return mask, level, peak


shapes = st.tuples(st.integers(1, 11), st.integers(1, 11))


@settings(max_examples=60)
@given(shapes, st.integers(1, 14), st.sampled_from(["inside", "reflect"]), st.integers(0, 2**31))
def test_box_mean(shape: tuple[int, int], kernel: int, border, seed: int) -> None:
    image = torch.rand(shape, generator=torch.Generator().manual_seed(seed))
    expected = literal_box_mean(image.double().numpy(), kernel, border)
    assert np.abs(box_mean(image, kernel, border).numpy() - expected).max() < 1e-6


def test_box_mean_is_average_pooling_without_counting_the_padding() -> None:
    maps = torch.rand(2, 3, 40, 33, generator=torch.Generator().manual_seed(0))
    pooled = torch.nn.functional.avg_pool2d(maps, 29, stride=1, padding=14, count_include_pad=False)
    torch.testing.assert_close(box_mean(maps, 29), pooled)


@pytest.mark.parametrize("border", ["inside", "reflect"])
@pytest.mark.parametrize("value", [0.1, 0.3, 0.7])
def test_constant_maps_stay_constant(border, value: float) -> None:
    averaged = box_mean(torch.full((300, 417), value), 7, border)
    assert len(averaged.unique()) == 1


@settings(max_examples=40)
@given(shapes, st.sampled_from(list(QUERY_PRESETS)), st.integers(1, 3), st.integers(0, 2**31))
def test_segment_equals_the_protocol_read_literally(
    shape: tuple[int, int], name: str, levels: int, seed: int
) -> None:
    # Coarse values, so that nothing lies within rounding of the threshold by chance of float32.
    relevancy = torch.randint(0, 256, (levels, *shape), generator=torch.Generator().manual_seed(seed)) / 256
    preset = QUERY_PRESETS[name]
    mask, level, score = literal_segment(relevancy.numpy(), preset)
    found = segment(relevancy, preset)
    assert found.level == level
    assert found.score == pytest.approx(score, abs=1e-6)
    assert float((found.mask.numpy() != mask).mean()) == 0
    assert found.coverage == pytest.approx(mask.mean())
    rows, columns = np.nonzero(mask)
    expected = (columns.min(), rows.min(), columns.max() + 1, rows.max() + 1) if mask.any() else None
    assert found.box == expected


def test_segment_finds_a_square_at_the_level_that_shows_it() -> None:
    relevancy = torch.full((3, 60, 80), 0.5)
    relevancy[1, 20:40, 30:60] = 0.9
    relevancy[2, 5:30, 5:30] = 0.8
    found = segment(relevancy)
    # At a straight edge the box is 4 / 7 inside: 0.786 of the range, just below the threshold's 0.8.
    assert (found.level, found.box) == (1, (31, 21, 59, 39))
    assert found.mask[24:36, 34:56].all()
    assert found.coverage == pytest.approx(18 * 28 / (60 * 80), rel=0.06)


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
    smoothed, masks = level_masks(relevancy, QUERY_PRESETS["scoup"])
    assert [float(level[mask].mean()) for level, mask in zip(smoothed, masks, strict=True)] == pytest.approx(
        [0.845, 0.87], abs=0.01
    )
    assert by_mask.mask.equal(masks[1])
    # The score is the largest smoothed relevancy of the level chosen, by either rule.
    assert by_mask.score == pytest.approx(0.88)
    assert by_peak.score == pytest.approx(float(smoothed[0].max()))
    assert (
        localize(relevancy, QUERY_PRESETS["default"]).level
        == localize(relevancy, QUERY_PRESETS["scoup"]).level
    )


def test_levels_with_empty_masks_answer_only_if_all_are_empty() -> None:
    relevancy = two_levels()
    relevancy[0] = 0.5
    relevancy[0, 10, 10] = 1.0  # the majority of 7 x 7 pixels removes so small a mask
    smoothed, masks = level_masks(relevancy, QUERY_PRESETS["default"])
    assert [bool(mask.any()) for mask in masks] == [False, True]
    assert choose_level(smoothed, masks, "mask") == 1
    nothing = torch.full((3, 20, 20), 0.5)
    nothing[1:, 10, 10] = 1.0
    found = segment(nothing, QUERY_PRESETS["default"])
    assert (found.level, found.box) == (1, None)


@pytest.mark.parametrize("choice", ["peak", "mask"])
def test_the_first_of_equal_levels_answers(choice) -> None:
    relevancy = two_levels()[[1, 1, 1]]
    assert choose_level(*level_masks(relevancy, QUERY_PRESETS["scoup"]), choice) == 0
    masks = torch.zeros(2, 4, 4, dtype=torch.bool)
    masks[0, 0, :3] = masks[1] = True
    # Means of different areas may be equal too.
    assert choose_level(torch.full((2, 4, 4), 0.1), masks, choice) == 0


def test_constant_maps_give_empty_masks_and_every_pixel_as_maximum() -> None:
    relevancy = torch.full((2, 9, 15), 0.5)
    found = segment(relevancy)
    assert (found.level, found.box, found.coverage) == (0, None, 0.0)
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


def test_localize_by_hand() -> None:
    relevancy = torch.zeros(3, 20, 30)
    relevancy[0, 3, 4] = 1.0  # a spike: large, but averaged away
    relevancy[2, 10:17, 15:22] = 0.8
    place = localize(relevancy)
    assert (place.pixel, place.level) == ((18, 13), 2)
    assert place.score == pytest.approx(0.8)
    assert place.pixels.tolist() == [[18, 13]]


def test_ties_are_all_reported_row_by_row_and_the_first_level_wins() -> None:
    relevancy = torch.zeros(2, 20, 40)
    relevancy[0, 10, 10] = relevancy[0, 10, 30] = relevancy[1, 5, 5] = 1.0
    preset = QueryPreset("one", kernel=1, border="inside", threshold=0.6, smoothing=1)
    place = localize(relevancy, preset)
    assert place.pixels.tolist() == [[10, 10], [30, 10]]
    assert place.level == 0
    assert place.pixel in [(10, 10), (30, 10)]


def test_rescale_and_mask_box() -> None:
    assert rescale(torch.tensor([0.0, 0.5, 0.75, 1.0])).tolist() == pytest.approx([0, 0, 0.5, 1])
    assert rescale(torch.full((3,), 0.7)).tolist() == [0, 0, 0]
    mask = torch.zeros(5, 6, dtype=torch.bool)
    assert mask_box(mask) is None
    mask[4, 5] = True
    assert mask_box(mask) == (5, 4, 6, 5)


def test_presets_by_name_and_data_set() -> None:
    assert query_preset("scoup") == QUERY_PRESETS["scoup"]
    assert query_preset("scoup", "3d-ovs").threshold == 0.3
    assert next(iter(QUERY_PRESETS)) == "default"
    for dataset, thresholds in DATASET_THRESHOLDS.items():
        everyday, paper = query_preset("default", dataset), query_preset("scoup", dataset)
        assert replace(everyday, name="scoup", level_choice="peak") == paper, thresholds
    assert query_preset("langsplatv2", "mipnerf360") == QueryPreset("langsplatv2", 29, "inside", 0.4, 7)
    assert query_preset("langsplat", threshold=0.1).threshold == 0.1
    with pytest.raises(UnknownNameError, match="scoup"):
        query_preset("skoup")
    with pytest.raises(UnknownNameError):
        query_preset("langsplat", "3d-ovs")
    with pytest.raises(UnknownNameError):
        query_preset("scoup", "imagenet")
    with pytest.raises(InputError):
        query_preset("scoup", threshold=1.5)
    with pytest.raises(InputError):
        QueryPreset("x", 0, "inside", 0.5, 1)
    with pytest.raises(InputError, match="peek"):
        QueryPreset("x", 7, "inside", 0.5, 1, "peek")  # pyright: ignore


@pytest.mark.parametrize("shape", [(3, 4), (0, 3, 4), (2, 0, 4), (1, 2, 3, 4)])
def test_shapes_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(InputError):
        localize(torch.zeros(shape))
    with pytest.raises(InputError):
        segment(torch.zeros(shape))


def fake_field(relevancy: Tensor, coded: Tensor, means: Tensor) -> SimpleNamespace:
    """What ``select`` asks of a field: relevancy [S, N] looked up by the query's first number."""

    def gaussian_relevancy(queries: Tensor, canonical: Tensor) -> Tensor:
        assert canonical.shape == (4, 2)
        return torch.stack([relevancy * query[0] for query in queries], 1)

    weights = coded.T[:, :, None].float()  # [N, S, 1]
    return SimpleNamespace(
        code_weights=weights, gaussian_relevancy=gaussian_relevancy, gaussians=SimpleNamespace(means=means)
    )


def literal_select(relevancy, coded, means, threshold, neighbours, rescaled) -> list[bool]:
    levels, count = relevancy.shape
    values = relevancy.copy()
    if neighbours:
        anywhere = [i for i in range(count) if coded[:, i].any()]
        for i in anywhere:
            others = sorted((j for j in anywhere if j != i), key=lambda j: np.sum((means[i] - means[j]) ** 2))
            for level in range(levels):
                near = [relevancy[level, j] for j in others[:neighbours] if coded[level, j]]
                if near:
                    values[level, i] = 0.5 * (relevancy[level, i] + np.mean(near))
    peaks = [max((values[s, i] for i in range(count) if coded[s, i]), default=-np.inf) for s in range(levels)]
    level = int(np.argmax(peaks))
    members = [i for i in range(count) if coded[level, i]]
    chosen = [False] * count
    low, high = (min(values[level, members]), max(values[level, members])) if members else (0, 0)
    for i in members:
        value = values[level, i]
        if rescaled:
            value = np.clip(2 * (value - low) / (high - low + 1e-9) - 1, 0, 1)
        chosen[i] = bool(value > threshold)
    return chosen


@settings(max_examples=30)
@given(st.integers(1, 40), st.sampled_from([None, 1, 10]), st.booleans(), st.integers(0, 2**31))
def test_select_equals_loops(count: int, neighbours: int | None, rescaled: bool, seed: int) -> None:
    generator = torch.Generator().manual_seed(seed)
    relevancy = torch.rand(3, count, generator=generator)
    coded = torch.rand(3, count, generator=generator) < 0.6
    means = torch.randn(count, 3, generator=generator)
    field = fake_field(relevancy, coded, means)
    chosen = select(field, torch.ones(2), torch.zeros(4, 2), 0.55, neighbours, rescaled)  # pyright: ignore
    expected = literal_select(
        relevancy.double().numpy(), coded.numpy(), means.double().numpy(), 0.55, neighbours, rescaled
    )
    assert chosen.tolist() == expected


def test_select_many_queries_and_refusals() -> None:
    field = fake_field(
        torch.tensor([[0.2, 0.9, 0.7]]), torch.tensor([[True, True, False]]), torch.zeros(3, 3)
    )
    queries = torch.tensor([[1.0, 0.0], [0.1, 0.0]])
    chosen = select(field, queries, torch.zeros(4, 2), rescaled=False)  # pyright: ignore
    assert chosen.tolist() == [[False, True, False], [False, False, False]]
    assert select(field, queries[:0], torch.zeros(4, 2)).shape == (0, 3)  # pyright: ignore
    with pytest.raises(InputError):
        select(field, queries[0], torch.zeros(4, 2), neighbours=0)  # pyright: ignore


def test_neighbours_at_one_place_and_not_finite() -> None:
    points = torch.zeros(30, 3)
    points[29] = torch.nan
    around = Neighbourhood.of(points, torch.ones(30, dtype=torch.bool), 5)
    assert around.nearest.shape == (29, 5)
    assert not (around.nearest == around.members[:, None]).any()
    alone = Neighbourhood.of(points[:1], torch.ones(1, dtype=torch.bool), 5)
    assert alone.blend(torch.tensor([[0.25]]), torch.ones(1, 1, dtype=torch.bool)).tolist() == [[0.25]]
