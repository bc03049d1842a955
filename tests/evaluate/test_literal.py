"""The rules of the papers, and every rule of the 2D protocols against the literal version, on awkward maps too."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from evaluate import literal
from messages import refuses
from scoup.base import InputError, UnknownNameError
from scoup_lab.data.labels import LabelledFrame
from scoup_lab.evaluate.protocols import PIXELS
from scoup_lab.evaluate.relevancy_maps import box_mean, choose_level, localize, segment
from scoup_lab.evaluate.rules import MASK_RULES, Border, LevelChoice, MaskRule
from support import examples

SCOUP = MASK_RULES["scoup"]
BY_MASK = MaskRule("by mask", 7, "inside", 0.6, 7, "mask")
shapes = st.tuples(st.integers(1, 11), st.integers(1, 11))


@settings(max_examples=examples(40))
@given(shapes, st.sampled_from([*MASK_RULES.values(), BY_MASK]), st.integers(1, 3), st.integers(0, 2**31))
def test_segment_equals_the_protocol_read_literally(
    shape: tuple[int, int], rule: MaskRule, levels: int, seed: int
) -> None:
    # Coarse values, so that nothing lies within rounding of the threshold by chance of float32.
    relevancy = torch.randint(0, 256, (levels, *shape), generator=torch.Generator().manual_seed(seed)) / 256
    constants = rule.kernel, rule.border, rule.threshold, rule.smoothing, rule.smoothing_border
    smoothed, masks = literal.masks(relevancy.numpy(), *constants)
    level = literal.chosen_level(smoothed, masks, rule.level_choice)
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
    assert found == literal.chosen_level(smoothed.astype(np.float64), masks, choice)


def test_localize_by_hand() -> None:
    relevancy = torch.zeros(3, 20, 30)
    relevancy[0, 3, 4] = 1.0  # a spike: large, but averaged away
    relevancy[2, 10:17, 15:22] = 0.8
    place = localize(relevancy, SCOUP)
    assert (place.pixel, place.level, place.pixels.tolist()) == ((18, 13), 2, [[18, 13]])
    assert place.score == pytest.approx(0.8)
    relevancy = torch.zeros(2, 20, 40)  # ties are all reported, row by row, and the first level wins
    relevancy[0, 10, 10] = relevancy[0, 10, 30] = relevancy[1, 5, 5] = 1.0
    place = localize(relevancy, MaskRule("one", kernel=1, border="inside", threshold=0.6, smoothing=1))
    assert (place.pixels.tolist(), place.level) == ([[10, 10], [30, 10]], 0)
    assert place.pixel in [(10, 10), (30, 10)]
    relevancy = torch.full((2, 9, 15), 0.5)  # of constant maps no mask, and every pixel is a maximum
    found, place = segment(relevancy, SCOUP), localize(relevancy, SCOUP)
    assert (found.level, bool(found.mask.any())) == (0, False)
    assert (place.pixel, place.level, len(place.pixels)) == ((7, 4), 0, 9 * 15)
    for shape in ((3, 4), (0, 3, 4), (2, 0, 4), (1, 2, 3, 4)):
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


def test_rules_are_those_of_the_protocols() -> None:
    """Box, threshold, mask smoothing and level rule, as docs/evaluation.md states them."""
    assert {
        "scoup": MaskRule("scoup", 7, "inside", 0.6, 7, "peak", "inside"),
        "langsplatv2": MaskRule("langsplatv2", 29, "inside", 0.4, 7, "peak", "inside"),
        "langsplat": MaskRule("langsplat", 30, "reflect", 0.4, 7, "peak", "but last"),
    } == MASK_RULES
    assert PIXELS["3d-ovs"].rule().level_choice == PIXELS["mipnerf360"].rule().level_choice == "mask"
    assert all(PIXELS["lerf-ovs"].rule(system) == rule for system, rule in MASK_RULES.items())
    assert PIXELS["3d-ovs"].rule("scoup").threshold == 0.3
    assert PIXELS["mipnerf360"].rule("langsplatv2").threshold == MASK_RULES["langsplatv2"].threshold
    for protocol in PIXELS.values():
        assert set(protocol.thresholds) <= set(MASK_RULES)
    for name, system in (("lerf-ovs", "skoup"), ("3d-ovs", "langsplat")):
        with refuses(UnknownNameError):
            PIXELS[name].rule(system)


HEIGHT, WIDTH = 9, 13


@st.composite
def maps(draw: st.DrawFn) -> np.ndarray:
    """[3, H, W] float32 relevancy: smooth, blocky (many ties of the maximum), constant, or with one bright pixel."""
    rng = np.random.default_rng(draw(st.integers(0, 2**31)))
    kind = draw(st.sampled_from(["noise", "blocks", "constant", "spike", "equal levels"]))
    values = rng.random((3, HEIGHT, WIDTH))
    if kind == "blocks":
        values = np.round(values[:, ::4, ::4]).repeat(4, 1).repeat(4, 2)[:, :HEIGHT, :WIDTH] * 0.5
    elif kind == "constant":
        values[:] = 0.5
    elif kind == "spike":
        values = np.full_like(values, 0.4)
        values[rng.integers(3), rng.integers(HEIGHT), rng.integers(WIDTH)] = 0.9
    elif kind == "equal levels":
        values[1:] = values[:1]
    return values.astype(np.float32)


@st.composite
def truths(draw: st.DrawFn) -> LabelledFrame:
    """One label "cup": some boxes, touching borders or lying outside; sometimes no pixel at all."""
    mask = torch.zeros(HEIGHT, WIDTH, dtype=torch.bool)
    boxes = []
    for _ in range(draw(st.integers(1, 3))):
        x, y = draw(st.integers(0, WIDTH - 1)), draw(st.integers(0, HEIGHT - 1))
        w, h = draw(st.integers(0, 8)), draw(st.integers(0, 8))
        boxes.append([x, y, x + w, y + h])
        mask[y : y + h + 1, x : x + w + 1] = True
    if draw(st.booleans()) and draw(st.booleans()):
        mask[:] = False
    return LabelledFrame("f", WIDTH, HEIGHT, {"cup": mask}, {"cup": torch.tensor(boxes, dtype=torch.float32)})


SYSTEMS = [
    *(("lerf-ovs", system) for system in ("scoup", "langsplatv2", "langsplat")),
    *((data_set, system) for data_set in ("3d-ovs", "mipnerf360") for system in ("scoup", "langsplatv2")),
]
CONSTANTS = {("3d-ovs", "scoup"): (0.3, 7), ("3d-ovs", "langsplatv2"): (0.25, 29),
           ("mipnerf360", "scoup"): (0.45, 7), ("mipnerf360", "langsplatv2"): (0.4, 29)}  # fmt: skip
"""Threshold and kernel of the protocols that choose the level by its mask; 3D-OVS leaves the finest level out."""


@settings(max_examples=examples(100))
@given(maps(), truths(), st.sampled_from(SYSTEMS))
def test_protocols(levels: np.ndarray, frame: LabelledFrame, case: tuple[str, str]) -> None:
    protocol = PIXELS[case[0]]
    (pair,) = protocol.score_frame(frame, torch.from_numpy(levels)[:, None], protocol.rule(case[1]))
    truth, boxes = frame.masks["cup"].numpy(), frame.boxes["cup"].tolist()
    if case in CONSTANTS:
        first, (threshold, kernel), hit = int(case[0] == "3d-ovs"), CONSTANTS[case], None
        iou, level = literal.mask_mean_level(levels[first:], truth, kernel, threshold)
        level += first
    else:
        rule = MASK_RULES[case[1]]
        rules = rule.kernel, rule.border, rule.threshold, rule.smoothing, rule.smoothing_border
        iou, level, hit = literal.lerf_ovs(levels, truth, boxes, *rules)
    assert (pair.iou, pair.level, pair.hit) == (pytest.approx(iou, abs=1e-9), level, hit)


@pytest.mark.parametrize("size", [(WIDTH * 2, HEIGHT * 3), (7, 5), (WIDTH + 1, HEIGHT - 1)])
def test_truth_is_resized_by_nearest_neighbour(size: tuple[int, int]) -> None:
    width, height = size
    mask = torch.from_numpy(np.random.default_rng(1).random((HEIGHT, WIDTH)) > 0.5)
    frame = LabelledFrame("f", WIDTH, HEIGHT, {"cup": mask}, {"cup": torch.zeros(1, 4)})
    truth = literal.nearest(mask.numpy(), width, height)
    assert frame.resized(width, height).masks["cup"].numpy().tolist() == truth.tolist()
    levels = np.random.default_rng(2).random((3, height, width)).astype(np.float32)
    maps = torch.from_numpy(levels)[:, None]
    with refuses():  # which is not done for this protocol
        PIXELS["mipnerf360"].score_frame(frame, maps)
    (pair,) = PIXELS["3d-ovs"].score_frame(frame, maps)
    assert pair.iou == pytest.approx(literal.mask_mean_level(levels[1:], truth, 7, 0.3)[0])
