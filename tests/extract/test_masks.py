"""Packed masks, and the rules over them; crops, and their embeddings by tiny models; against literal versions."""

from __future__ import annotations

import numpy as np
import torch
from hypothesis import given
from hypothesis import strategies as st

from literal_rules import box_of, box_suppression, clean_up, exact_crop_of, mask_rule, painted
from mask_samples import mask_stacks, random_masks
from messages import refuses
from scoup.extract.automatic_masks import without_small_parts
from scoup.extract.crops import mask_crops
from scoup.extract.masks import Masks, paint
from scoup.extract.overlaps import intersections, keep_by_boxes, keep_by_masks
from scoup.models.plain_colors import PlainColors


@given(mask_stacks())
def test_packed_masks_are_the_masks(dense: np.ndarray) -> None:
    masks = Masks.from_dense(dense)
    assert (masks.dense() == dense).all()
    assert masks.areas().tolist() == dense.sum((1, 2)).tolist()
    assert masks.corners().tolist() == [box_of(mask) for mask in dense]
    assert (paint(masks) == painted(list(dense), dense.shape[1:])).all()
    chosen = np.arange(len(dense))[::-2]
    assert (masks.select(chosen).dense() == dense[chosen]).all()
    filled = np.asarray(dense.any((1, 2)), np.bool_)
    assert (masks.select(filled).dense() == dense[filled]).all()
    height, width = dense.shape[1:]
    moved = masks.translate(3, 2, (height + 5, width + 4)).dense()
    assert (moved == np.pad(dense, ((0, 0), (2, 3), (3, 1)))).all()
    again = Masks.concatenate(masks.size, [masks, masks.select(chosen)])
    assert (again.dense() == np.concatenate([dense, dense[chosen]])).all()


def test_masks_of_labels() -> None:
    labels = np.random.default_rng(0).integers(-1, 6, (9, 7))
    labels[labels == 3] = 4  # a number that is not used
    masks = Masks.from_labels(labels)
    assert (masks.dense() == np.stack([labels == value for value in range(labels.max() + 1)])).all()
    assert len(Masks.from_labels(np.full((3, 3), -1))) == 0
    with refuses():
        Masks.concatenate((9, 7), [masks, Masks.from_dense(np.ones((1, 2, 2), bool))])


@given(mask_stacks())
def test_intersections(dense: np.ndarray) -> None:
    flat = dense.reshape(len(dense), dense.shape[1] * dense.shape[2]).astype(np.int64)
    assert (intersections(Masks.from_dense(dense)) == flat @ flat.T).all()


@given(st.integers(0, 2**31), st.integers(0, 60), st.sampled_from([0.0, 0.3, 0.7, 1.0]))
def test_box_suppression(seed: int, count: int, limit: float) -> None:
    rng = np.random.default_rng(seed)
    start = rng.integers(0, 20, (count, 2))
    boxes = np.concatenate([start, start + rng.integers(0, 12, (count, 2))], axis=1)  # some without area
    scores = rng.integers(0, 5, count) / 4  # many ties
    expected = box_suppression(boxes.tolist(), scores.tolist(), limit)
    assert keep_by_boxes(boxes, scores, limit).tolist() == expected


@given(mask_stacks(), st.integers(0, 2**31))
def test_small_parts(dense: np.ndarray, seed: int) -> None:
    dense = dense[dense.any((1, 2))]  # an empty mask has no stability and never gets here
    least = int(np.random.default_rng(seed).choice([0, 1, 2, 5, 20, 100, 10_000]))
    cleaned = without_small_parts(Masks.from_dense(dense), least, 0.7)
    expected, kept = clean_up(list(dense), least, 0.7)
    assert len(cleaned) == len(expected)
    assert all((one == other).all() for one, other in zip(cleaned.dense(), expected, strict=True))
    marked = Masks.from_dense(dense, np.arange(len(dense), dtype=np.float32))
    assert without_small_parts(marked, least, 0.7).predicted_iou.tolist() == kept


@given(mask_stacks(), st.integers(0, 2**31))
def test_mask_rule(dense: np.ndarray, seed: int) -> None:
    dense = dense[dense.any((1, 2))]  # an empty mask has no stability and never gets here
    scores = np.random.default_rng(seed).choice([0.65, 0.7, 0.75, 0.8, 0.9, 0.95], len(dense))
    expected = mask_rule(torch.from_numpy(dense), torch.from_numpy(scores))
    assert keep_by_masks(Masks.from_dense(dense), scores).tolist() == expected


def test_mask_rule_by_hand() -> None:
    """One of each reason to go, and a mask that went still makes others go."""
    dense = np.zeros((5, 20, 20), bool)
    dense[0, :10, :10] = True
    dense[1, :10, :9] = True  # IoU 0.9 with the first
    dense[2, 12:20, 12:20] = True  # low score
    dense[3, 13:16, 13:16] = True  # inside the third, of which it covers 0.14
    dense[4, :, 15:] = True
    scores = np.array([0.95, 0.9, 0.7, 0.99, 0.8])
    assert keep_by_masks(Masks.from_dense(dense), scores).tolist() == [0, 4]
    assert keep_by_masks(Masks.from_dense(dense), scores, covered=0.1).tolist() == [0, 3, 4]
    assert keep_by_masks(Masks.from_dense(dense), scores, most_overlap=0.9).tolist() == [0, 1, 4]


def test_random_masks_exercise_the_rules() -> None:
    """The oracle tests mean little if nothing is ever dropped, or everything."""
    dense = random_masks(40, 30, 30, 0)
    dense = dense[dense.any((1, 2))]
    kept = keep_by_masks(Masks.from_dense(dense), np.linspace(0.6, 1, len(dense)))
    assert 3 < len(kept) < len(dense) - 3
    cleaned = without_small_parts(Masks.from_dense(dense), 20, 0.7)
    assert 5 < len(cleaned) < len(dense) - 2


@given(mask_stacks(most=8), st.sampled_from([1, 7, 32]), st.booleans())
def test_crops_are_those_of_the_recipe(dense: np.ndarray, side: int, cut_last: bool) -> None:
    dense = dense[dense.any((1, 2))]
    image = np.random.default_rng(0).integers(0, 256, (*dense.shape[1:], 3)).astype(np.uint8)
    parts = list(mask_crops(torch.from_numpy(image), Masks.from_dense(dense), side, cut_last, 3))
    assert [len(part) for part in parts[:-1]] == [3] * (len(parts) - 1)
    for crop, mask in zip((crop.numpy() for part in parts for crop in part), dense, strict=True):
        # Sums in another order may round the other way, where they lie halfway between two numbers.
        assert np.abs(crop - exact_crop_of(image, mask, side, cut_last)).max() <= 0.5 + 1e-3


def test_plain_colors_tell_colours_apart_and_ignore_what_is_black() -> None:
    embedder = PlainColors()
    red, green = torch.zeros(2, 64, 64, 3, dtype=torch.uint8)
    red[..., 0], green[..., 1] = 200, 200
    half = red.clone()
    half[:, 32:] = 0
    striped = red.clone()
    striped[::4] = 90
    rows = embedder.embed(torch.stack([red, green, half, striped, torch.zeros_like(red)]))
    assert rows.shape == (5, embedder.dim)
    cosines = rows @ rows.T
    torch.testing.assert_close(rows[:4].norm(dim=1), torch.ones(4))
    assert float(rows[4].abs().sum()) == 0  # nothing to see: "unknown"
    assert float(cosines[0, 2]) > 0.9  # the same colour, half of it
    assert float(cosines[0, 1]) < 0.5
    assert float(cosines[0, 3]) < float(cosines[0, 2])
