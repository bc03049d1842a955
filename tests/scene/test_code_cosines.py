"""Cosines and scores of codes against decoding."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from raster.parity import needs_native
from scoup.base.errors import InputError
from scoup.scene.codes import code_scores, cosines_from_codes, plain_code_scores
from support import examples


def test_cosines_equal_decoding_and_normalising() -> None:
    generator = torch.Generator().manual_seed(1)
    codebook = torch.randn(16, 512, generator=generator) + 0.5
    queries = torch.nn.functional.normalize(torch.randn(5, 512, generator=generator), dim=1)
    weights = torch.rand(7, 3, 16, generator=generator) * (torch.rand(7, 3, 16, generator=generator) < 0.3)
    weights[0, 0] = 0
    weights[1] *= 1e-6  # a pixel that is nearly transparent has the same direction
    decoded = torch.nn.functional.normalize(weights @ codebook, dim=-1)
    cosines = cosines_from_codes(weights, codebook, queries)
    assert cosines.shape == (7, 3, 5)
    torch.testing.assert_close(cosines, decoded @ queries.T, atol=2e-6, rtol=0)
    assert cosines[0, 0].tolist() == [0.0] * 5


@needs_native
@settings(max_examples=examples(40))
@given(
    count=st.integers(0, 70),
    k=st.integers(0, 6),
    n_atoms=st.sampled_from([1, 7, 256, 300]),
    columns=st.integers(0, 5),
    half=st.booleans(),
    seed=st.integers(0, 999),
)
def test_code_scores(count, k, n_atoms, columns, half, seed) -> None:
    generator = torch.Generator().manual_seed(seed)
    dtype = torch.uint8 if n_atoms <= 256 else torch.uint16
    indices = torch.randint(n_atoms, (count, 2, k), generator=generator).to(dtype)
    weights = torch.rand(count, 2, k, generator=generator)
    weights = weights.half() if half else weights
    scores = torch.randn(2, n_atoms, columns, generator=generator)
    found, expected = (way(indices, weights, scores) for way in (code_scores, plain_code_scores))
    torch.testing.assert_close(found, expected, rtol=1e-5, atol=1e-6)


def test_code_scores_refuse_atoms_there_are_not() -> None:
    indices = torch.full((5, 1, 2), 7, dtype=torch.uint8)
    with pytest.raises(InputError):
        code_scores(indices, torch.ones(5, 1, 2), torch.zeros(1, 7, 1))
