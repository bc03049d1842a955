"""Codes of unit norm: sums of a few products are cosines."""

from __future__ import annotations

import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from view_samples import DIM, random_field

from scoup.field import relevancy
from scoup.field.code_sums import code_scores
from scoup.view.unit_codes import UnitCodes, atom_scores
from support import examples, unit


@settings(max_examples=examples(30), deadline=None)
@given(st.integers(0, 40), st.integers(0, 2**31), st.sampled_from([1, 9, 300]), st.sampled_from([1, 3, 4, 9]))
def test_cosines_are_those_of_the_field(count: int, seed: int, n_atoms: int, k: int) -> None:
    field = random_field(count, seed, n_atoms, k)
    queries = unit(torch.randn(3, DIM, generator=torch.Generator().manual_seed(seed)))
    canonical = unit(torch.randn(2, DIM, generator=torch.Generator().manual_seed(seed + 1)))
    codes = UnitCodes.of(field)
    of_queries, of_canonical = (
        code_scores(codes.indices, codes.weights, atom_scores(field, vectors)).permute(1, 2, 0)
        for vectors in (queries, canonical)
    )
    found = relevancy(of_queries, of_canonical)
    torch.testing.assert_close(found, field.gaussian_relevancy(queries, canonical), atol=2e-5, rtol=0)


def test_confidence_is_one_where_all_regions_agree_and_less_the_more_they_differ() -> None:
    field = random_field(3, k=2, n_atoms=4)
    field.codebook[0, :3] = torch.eye(DIM)[:3]
    field.codebook[0, 1] = unit(torch.eye(DIM)[0] + 0.2 * torch.eye(DIM)[1])
    field.code_indices[:, 0] = torch.tensor([[0, 3], [0, 1], [0, 2]], dtype=torch.uint8)
    field.code_weights[:, 0] = torch.tensor([[1.0, 0.0], [0.5, 0.5], [0.5, 0.5]]).half()
    confidence = UnitCodes.of(field).confidence[:, 0]
    assert confidence[0] == 1
    assert 0.99 < float(confidence[1]) < 1
    assert abs(float(confidence[2]) - 0.5**0.5) < 1e-3  # two that are at right angles
    field.code_weights[0] = 0
    nothing = UnitCodes.of(field)
    assert nothing.confidence[0].tolist() == [0, 0]
    assert not nothing.weights[0].any()
