"""Rotations as matrices and quaternions."""

from __future__ import annotations

import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from scoup.scene.rotations import quats_of_rotations, rotation_matrices
from support import examples


@settings(max_examples=examples(50), deadline=None)
@given(
    st.lists(st.tuples(*[st.sampled_from([-1.0, -1e-9, 0.0, 1e-9, 0.3, 1.0])] * 4).filter(any), min_size=1)
)
def test_quaternions_of_matrices(quats: list[tuple[float, ...]]) -> None:
    given = torch.nn.functional.normalize(torch.tensor(quats, dtype=torch.float64), dim=1)
    matrices = rotation_matrices(given)
    found = quats_of_rotations(matrices)
    torch.testing.assert_close(rotation_matrices(found), matrices, atol=1e-12, rtol=0)
    torch.testing.assert_close((found * given).sum(1).abs(), torch.ones(len(given), dtype=torch.float64))
