"""Spherical k-means: clear clusters, degenerate rows, determinism."""

from __future__ import annotations

import itertools

import pytest
import torch

from scoup.coding.kmeans import spherical_kmeans


def test_finds_well_separated_clusters() -> None:
    generator = torch.Generator().manual_seed(0)
    centres = torch.linalg.qr(torch.randn(16, 6, generator=generator)).Q.T
    rows = centres.repeat_interleave(20, 0) + 0.05 * torch.randn(120, 16, generator=generator)
    atoms = spherical_kmeans(torch.nn.functional.normalize(rows, dim=1), 6, seed=3)
    torch.testing.assert_close(torch.linalg.vector_norm(atoms, dim=1), torch.ones(6))
    nearest = (centres @ atoms.T).max(1)
    assert sorted(nearest.indices.tolist()) == list(range(6))
    assert float(nearest.values.min()) > 0.99


def test_lloyd_never_worsens_the_fit() -> None:
    rows = torch.nn.functional.normalize(
        torch.randn(300, 8, generator=torch.Generator().manual_seed(1)), dim=1
    )
    fits = [float((rows @ spherical_kmeans(rows, 10, 0, n).T).amax(1).mean()) for n in range(8)]
    assert all(later >= earlier - 1e-6 for earlier, later in itertools.pairwise(fits))


@pytest.mark.parametrize(("count", "distinct"), [(1, 1), (3, 3), (50, 1), (50, 2)])
def test_identical_and_few_rows(count: int, distinct: int) -> None:
    base = torch.nn.functional.normalize(
        torch.randn(distinct, 5, generator=torch.Generator().manual_seed(0)), dim=1
    )
    rows = base[torch.arange(count) % distinct]
    atoms = spherical_kmeans(rows, 8, seed=0)
    assert atoms.shape == (8, 5)
    torch.testing.assert_close((rows @ atoms.T).amax(1), torch.ones(count))


def test_same_seed_same_atoms() -> None:
    rows = torch.nn.functional.normalize(
        torch.randn(200, 8, generator=torch.Generator().manual_seed(1)), dim=1
    )
    assert spherical_kmeans(rows, 12, 5).equal(spherical_kmeans(rows, 12, 5))
    assert not spherical_kmeans(rows, 12, 5).equal(spherical_kmeans(rows, 12, 6))
