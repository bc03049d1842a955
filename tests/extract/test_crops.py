"""Crops, and their embeddings by tiny models, against the recipe written out; colours as embeddings."""

from __future__ import annotations

import numpy as np
import torch
from hypothesis import given
from hypothesis import strategies as st

from literal_rules import exact_crop_of
from mask_samples import mask_stacks
from scoup.extract.crops import mask_crops
from scoup.extract.masks import Masks
from scoup.extract.plain_colors import PlainColors


def all_crops(
    image: np.ndarray, dense: np.ndarray, side: int, cut_last: bool = True, batch: int = 3
) -> np.ndarray:
    masks = Masks.from_dense(dense)
    parts = list(mask_crops(torch.from_numpy(image), masks, side, cut_last, batch))
    assert [len(part) for part in parts[:-1]] == [batch] * (len(parts) - 1)
    return torch.cat(parts).numpy() if parts else np.zeros((0, side, side, 3), np.uint8)


@given(mask_stacks(most=8), st.sampled_from([1, 7, 32]), st.booleans())
def test_crops_are_those_of_the_recipe(dense: np.ndarray, side: int, cut_last: bool) -> None:
    dense = dense[dense.any((1, 2))]
    image = np.random.default_rng(0).integers(0, 256, (*dense.shape[1:], 3)).astype(np.uint8)
    crops = all_crops(image, dense, side, cut_last)
    for crop, mask in zip(crops, dense, strict=True):
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
