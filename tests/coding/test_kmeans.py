"""Spherical k-means: clear clusters, and fits that never get worse."""

from __future__ import annotations

import itertools

import pytest
import torch
from coders import clip_like
from torch import Tensor

from scoup.coding.backends import coding_backend
from scoup.coding.kmeans import spherical_kmeans


def centres_of(rows: Tensor, count: int, iterations: int = 2, backend: str = "reference") -> Tensor:
    random = torch.Generator().manual_seed(0)
    return spherical_kmeans(rows, count, random, coding_backend(backend), iterations)


@pytest.mark.parametrize("of_each", [20, 1000])  # all rows, and more than the sample
def test_finds_well_separated_clusters(backend: str, of_each: int) -> None:
    generator = torch.Generator().manual_seed(0)
    centres = torch.linalg.qr(torch.randn(16, 6, generator=generator)).Q.T  # at right angles
    rows = centres.repeat_interleave(of_each, 0)
    rows = torch.nn.functional.normalize(rows + 0.05 * torch.randn(rows.shape, generator=generator), dim=1)
    atoms = centres_of(rows, 6, backend=backend)
    torch.testing.assert_close(torch.linalg.vector_norm(atoms, dim=1), torch.ones(6))
    nearest = (centres @ atoms.T).max(1)
    assert sorted(nearest.indices.tolist()) == list(range(6))
    assert float(nearest.values.min()) > 0.99


def test_lloyd_never_worsens_the_fit() -> None:
    rows = clip_like(300, 8, objects=60)
    fits = [float((rows @ centres_of(rows, 10, n).T).amax(1).mean()) for n in range(8)]
    assert all(later >= earlier - 1e-6 for earlier, later in itertools.pairwise(fits))
