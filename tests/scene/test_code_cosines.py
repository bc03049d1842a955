"""Cosines of codes against decoding."""

from __future__ import annotations

import torch

from scoup.scene.codes import cosines_from_codes


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
