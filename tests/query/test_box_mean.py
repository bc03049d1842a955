"""Box means and rescaling against literal loops and hand-made cases."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from query.box_means import literal_box_mean
from scoup.query.segment import mask_box
from scoup.query.smoothing import box_mean, rescale
from support import examples

shapes = st.tuples(st.integers(1, 11), st.integers(1, 11))


@settings(max_examples=examples(60))
@given(shapes, st.integers(1, 14), st.sampled_from(["inside", "reflect"]), st.integers(0, 2**31))
def test_box_mean(shape: tuple[int, int], kernel: int, border, seed: int) -> None:
    image = torch.rand(shape, generator=torch.Generator().manual_seed(seed))
    expected = literal_box_mean(image.double().numpy(), kernel, border)
    assert np.abs(box_mean(image, kernel, border).numpy() - expected).max() < 1e-6


@pytest.mark.parametrize("border", ["inside", "reflect"])
@pytest.mark.parametrize("value", [0.1, 0.3, 0.7])
def test_constant_maps_stay_constant(border, value: float) -> None:
    averaged = box_mean(torch.full((300, 417), value), 7, border)
    assert len(averaged.unique()) == 1


def test_rescale_and_mask_box() -> None:
    assert rescale(torch.tensor([0.0, 0.5, 0.75, 1.0])).tolist() == pytest.approx([0, 0, 0.5, 1])
    assert rescale(torch.full((3,), 0.7)).tolist() == [0, 0, 0]
    mask = torch.zeros(5, 6, dtype=torch.bool)
    assert mask_box(mask) is None
    mask[4, 5] = True
    assert mask_box(mask) == (5, 4, 6, 5)
