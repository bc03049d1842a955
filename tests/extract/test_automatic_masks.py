"""Automatic masks against the literal generator, with tiny SAM models and with answers made up at random."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy import ndimage
from torch import Tensor
from torch.nn import functional

from literal_rules import Generator, cut_off, mask_rule
from mask_samples import smooth_image
from messages import refuses
from scoup.extract.automatic_masks import (
    SamSegmenter,
    automatic_masks,
    coarse_to_fine,
    crop_boxes,
    point_grid,
    touches_inner_edge,
)
from scoup.extract.settings import MaskSettings, mask_settings
from scoup.models import open_sam
from support import examples
from tiny_models import TINY_SAMS, saved

LIVELY = MaskSettings(
    points_per_side=5, points_per_batch=7, predicted_iou=0.5, stability=0.7, stability_offset=0.1,
    least_area=12, least_score=0.4,
)  # fmt: skip


class MadeUp:
    """A point model whose answers are blobs around the points, with random quality: many overlaps, many ties."""

    def __init__(self, seed: int, small: int = 24) -> None:
        self.seed, self.small = seed, small
        self.asked: list[list[float]] = []

    def to_dict(self) -> dict[str, Any]:
        return {"segmenter": "made up", "seed": self.seed}

    def encode(self, image: np.ndarray) -> MadeUpImage:
        return MadeUpImage(image, self)


class MadeUpImage:
    def __init__(self, image: np.ndarray, model: MadeUp) -> None:
        self.size, self.small, self.asked = image.shape[:2], model.small, model.asked
        self.seed = model.seed + int(image.astype(np.int64).sum()) % 1000
        rng = np.random.default_rng(self.seed)
        self.noise = ndimage.gaussian_filter(rng.normal(size=(self.small, self.small)), 2) * 8

    def predict(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Deterministic in the point alone: other batches change nothing."""
        self.asked += points.tolist()
        masks, quality = [], []
        rows, columns = np.mgrid[: self.small, : self.small] + 0.5
        for x, y in points.tolist():
            rng = np.random.default_rng([self.seed, int(x * 16), int(y * 16)])
            px, py = x / self.size[1] * self.small, y / self.size[0] * self.small
            distance = np.hypot(rows - py, columns - px)
            radii = np.sort(rng.uniform(0.5, self.small * 0.7, 3))
            noise = rng.normal(size=(3, *distance.shape)) * 0.3
            masks.append(radii[:, None, None] - distance + self.noise + noise)
            quality.append(rng.integers(8, 21, 3) / 20)
        return torch.from_numpy(np.stack(masks)).float(), torch.from_numpy(np.stack(quality)).float()

    def without_padding(self, logits: Tensor) -> Tensor:
        return logits

    def upscale(self, logits: Tensor) -> Tensor:
        return functional.interpolate(logits[:, None], self.size, mode="bilinear", align_corners=False)[:, 0]


def answers_of(model: Any):
    """The model as the literal generator calls it: a crop and points in, masks at the size of the crop out."""

    def answer(part: np.ndarray, points: np.ndarray) -> tuple[Tensor, Tensor]:
        encoded = model.encode(np.ascontiguousarray(part))
        logits, iou = encoded.predict(torch.from_numpy(points))
        return encoded.upscale(logits.flatten(0, 1)).unflatten(0, logits.shape[:2]), iou

    return answer


def compare(image: np.ndarray, model: Any, chosen: MaskSettings) -> dict[str, int]:
    """Every level must be the literal one, in order; returns how many masks each has."""
    generator = Generator(
        chosen.points_per_side, chosen.points_per_batch, chosen.crop_layers, chosen.predicted_iou,
        chosen.stability, chosen.stability_offset, chosen.box_overlap, chosen.crop_overlap, chosen.least_area,
        chosen.crop_share,
    )  # fmt: skip
    literal = generator.generate(image, answers_of(model))
    found = automatic_masks(image, model, chosen)
    assert list(found) == ["s", "m", "l"]
    counts = {}
    for level, items in literal.items():
        if not items:
            assert not len(found[level])
            continue
        dense = np.stack([item[0] for item in items])
        scores = torch.tensor([item[1] * item[2] for item in items], dtype=torch.float64)
        kept = mask_rule(torch.from_numpy(dense), scores, least_score=chosen.least_score)
        assert (found[level].dense() == dense[kept]).all()
        assert len(found[level]) == len(kept)
        np.testing.assert_allclose(found[level].predicted_iou, [items[n][1] for n in kept], atol=1e-6)
        np.testing.assert_allclose(found[level].stability, [items[n][2] for n in kept], atol=1e-6)
        counts[level] = len(kept)
    return counts


@settings(max_examples=examples(15))
@given(st.integers(0, 2**31), st.sampled_from([(40, 52), (61, 33), (50, 50)]), st.integers(0, 1))
@example(0, (60, 80), LIVELY.crop_layers)
def test_made_up_answers(seed: int, size: tuple[int, int], layers: int) -> None:
    counts = compare(smooth_image(*size, seed), MadeUp(seed), replace(LIVELY, crop_layers=layers))
    if size == (60, 80):  # the comparison is not empty
        assert min(counts.values()) >= 2
        assert sum(counts.values()) > 15


@pytest.mark.parametrize("kind", list(TINY_SAMS))
def test_tiny_models(kind: str, tmp_path) -> None:
    model = open_sam(str(saved(TINY_SAMS[kind](), tmp_path / kind)))
    image = smooth_image(70, 90)
    chosen = replace(LIVELY, points_per_side=5, stability=0.3, stability_offset=0.02, least_score=0.0)
    counts = compare(image, model, chosen)
    assert sum(counts.values()) >= 2


@settings(max_examples=examples(15))
@given(st.integers(0, 2**31), st.integers(1, 20), st.sampled_from([1, 3, 100]))
def test_points_with_known_masks_are_left_out_and_no_others(seed: int, side: int, batch: int) -> None:
    height, width = 48, 60
    chosen = replace(
        LIVELY, points_per_side=side, points_per_batch=batch, crop_layers=0,
        coarse_filters=True, by_need=True,
    )  # fmt: skip
    model, image = MadeUp(seed), smooth_image(height, width, seed)
    found = automatic_masks(image, model, chosen)
    wanted: list[tuple[float, float]] = []
    # Over each pixel: masks of level s; of points without one, the smallest.
    small, large = np.zeros((2, 24, 24), np.int64)
    rounds = coarse_to_fine(side)
    for number, points in enumerate(rounds):
        fresh = []
        for place in np.flatnonzero(points).tolist():
            px, py = (place % side + 0.5) / side, (place // side + 0.5) / side
            place = int(py * 24), int(px * 24)
            if not small[place] and (large[place] < 8 or number + 1 < len(rounds)):
                fresh.append((px * width, py * height))
        wanted += fresh
        encoded = MadeUp(seed).encode(image)
        for point in fresh:
            logits, iou = encoded.predict(torch.tensor([point], dtype=torch.float64))
            for level, mask in enumerate(logits[0].numpy()):
                areas = [(mask > offset).sum() for offset in (0.1, -0.1)]
                if iou[0, level] > 0.5 and areas[1] and np.float32(areas[0]) / np.float32(areas[1]) >= 0.7:
                    counts = large if level else small
                    counts += mask > 0
                    break
    np.testing.assert_allclose(model.asked, wanted)
    whole = automatic_masks(image, MadeUp(seed), replace(chosen, points_per_batch=50))
    assert all((found[level].dense() == whole[level].dense()).all() for level in found)


@pytest.mark.parametrize("side", [1, 2, 7, 20, 32])
def test_points_from_coarse_to_fine(side: int) -> None:
    rounds = np.stack(coarse_to_fine(side))
    assert (rounds.sum(0) == 1).all()
    if side == 32:
        assert rounds.sum(1).tolist() == [16, 16, 32, 64, 128, 256, 512]
        assert np.flatnonzero(rounds[0])[:5].tolist() == [99, 107, 115, 123, 355]


def test_batches_and_chunks_change_nothing(monkeypatch) -> None:
    image, model = smooth_image(60, 80), MadeUp(3)
    one = automatic_masks(image, model, replace(LIVELY, points_per_batch=1))
    monkeypatch.setattr("scoup.extract.automatic_masks.CHUNK_BYTES", 4 * 60 * 80 * 2)  # two masks at a time
    other = automatic_masks(image, model, replace(LIVELY, points_per_batch=1000))
    for level, masks in one.items():
        assert (masks.dense() == other[level].dense()).all()


def test_coarse_filters_nearly_agree() -> None:
    """Judged on small masks: not the same masks, but most of them, and the labels of most pixels."""
    image, model = smooth_image(96, 128), MadeUp(5, small=48)
    exact = automatic_masks(image, model, replace(LIVELY, crop_layers=0))
    coarse = automatic_masks(image, model, replace(LIVELY, crop_layers=0, coarse_filters=True))
    for level, masks in exact.items():
        one, other = masks.dense(), coarse[level].dense()
        best = [max(((m & o).sum() / (m | o).sum() for o in other), default=0) for m in one]
        assert np.mean(np.array(best) > 0.95) > 0.6


def test_no_answer_passes() -> None:
    for coarse in (False, True):
        chosen = replace(LIVELY, predicted_iou=2.0, coarse_filters=coarse)
        found = automatic_masks(smooth_image(30, 40), MadeUp(0), chosen)
        assert all(len(masks) == 0 and masks.size == (30, 40) for masks in found.values())


def test_grids_and_crops() -> None:
    grid = point_grid(32)
    assert grid.shape == (1024, 2)
    np.testing.assert_allclose(grid[0], [1 / 64, 1 / 64])
    np.testing.assert_allclose(grid[1], [3 / 64, 1 / 64])
    # SAM's own numbers for 1080 x 1440: overlap 368, crops of 904 x 724.
    crops = [(left, top, left + 904, top + 724) for left in (0, 536) for top in (0, 356)]
    assert crop_boxes(1080, 1440, 1, 512 / 1500) == [(0, 0, 1440, 1080), *crops]
    assert len(crop_boxes(500, 400, 2, 0.3)) == 1 + 4 + 16
    boxes = np.random.default_rng(0).integers(0, 300, (200, 4))
    crop = (100, 0, 380, 260)
    expected = [cut_off(box, crop, 400, 300) for box in boxes.tolist()]
    assert touches_inner_edge(boxes, crop, 300, 400).tolist() == expected
    assert 0 < sum(expected) < 200


def test_settings_and_records() -> None:
    faithful = mask_settings("langsplat")
    assert (faithful.points_per_side, faithful.predicted_iou, faithful.stability) == (32, 0.7, 0.85)
    assert (faithful.mask_overlap, faithful.least_score, faithful.inside) == (0.8, 0.7, 0.85)
    assert mask_settings("fast", points_per_side=8, stability=None).points_per_side == 8
    for preset, changes in (
        ("fast", {"points_per_side": 0}), ("fast", {"crop_layers": 9}), ("fast", {"least_area": -1}), ("best", {}),
    ):  # fmt: skip
        with refuses():
            mask_settings(preset, **changes)  # pyright: ignore[reportArgumentType]
    one, other, fast = (
        SamSegmenter(MadeUp(1), chosen).to_dict()
        for chosen in (faithful, replace(faithful, points_per_batch=9), mask_settings("fast"))
    )
    assert one == other != fast  # how many at a time decides only memory
    assert one["seed"] == 1
