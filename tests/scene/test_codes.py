"""Sparse codes: the top-K step and the Gram shortcut."""

from __future__ import annotations

import torch
from hypothesis import given
from hypothesis import strategies as st

from messages import refuses
from scoup.raster import cosines_from_codes
from scoup.scene.codes import SparseCodes, index_dtype
from support import unit


@given(rows=st.integers(0, 20), atoms=st.integers(1, 30), k=st.integers(1, 12), seed=st.integers(0, 999))
def test_top_k_keeps_the_largest_and_sums_to_one(rows, atoms, k, seed):
    generator = torch.Generator().manual_seed(seed)
    dense = (torch.rand(rows, atoms, generator=generator) - 0.4).clamp(min=0)
    codes = SparseCodes.from_dense(dense, k)
    back = codes.to_dense()
    for row, kept in zip(dense, back, strict=True):
        expected = torch.zeros(atoms)
        best = sorted(range(atoms), key=lambda j: (-row[j].item(), j))[: min(k, atoms)]
        total = sum(row[j].item() for j in best)
        if total > 0:
            expected[best] = row[best] / total
        assert torch.allclose(kept, expected, atol=1e-6)
    assert (codes.weights[:, :-1] >= codes.weights[:, 1:]).all()


def test_rows_without_positive_entries_equal_entries_and_many_atoms():
    assert not SparseCodes.from_dense(torch.tensor([[0.0, 0.0], [-1.0, 0.0]]), 2).weights.any()
    assert SparseCodes.from_dense(torch.full((1, 9), 0.25), 3).indices.tolist() == [[0, 1, 2]]
    assert index_dtype(256) == torch.uint8
    assert SparseCodes.from_dense(torch.rand(2, 257), 4).indices.dtype == torch.uint16


def test_wrong_parts_are_refused():
    with refuses():
        index_dtype(70000)
    for kind, columns in ((torch.uint8, 4), (torch.int64, 3)):
        with refuses():
            SparseCodes(torch.zeros(2, 3, dtype=kind), torch.zeros(2, columns), 8)


@given(seed=st.integers(0, 999), scale=st.sampled_from([1e-6, 1.0, 1e4]))
def test_gram_shortcut_equals_decoding(seed, scale):
    generator = torch.Generator().manual_seed(seed)
    weights = torch.rand(3, 5, 8, generator=generator) * scale
    weights[0, 0] = 0
    codebook = torch.randn(8, 32, generator=generator)
    queries = unit(torch.randn(4, 32, generator=generator))
    decoded = unit(weights.double() @ codebook.double()) @ queries.double().T
    assert torch.allclose(cosines_from_codes(weights, codebook, queries).double(), decoded, atol=1e-5)
