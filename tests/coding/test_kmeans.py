"""Spherical k-means: clear clusters, degenerate rows, determinism."""

from __future__ import annotations

import itertools

import pytest
import torch
from coders import assert_one_at_each, clusters
from torch import Tensor

from scoup.coding.kmeans import spherical_kmeans
from support import unit


def rows_of(count: int, dim: int, seed: int = 1) -> Tensor:
    return unit(torch.randn(count, dim, generator=torch.Generator().manual_seed(seed)))


def test_finds_well_separated_clusters() -> None:
    centres, rows = clusters(20)
    atoms = spherical_kmeans(rows, 6, seed=3)
    torch.testing.assert_close(torch.linalg.vector_norm(atoms, dim=1), torch.ones(6))
    assert_one_at_each(centres, atoms)


def test_lloyd_never_worsens_the_fit() -> None:
    rows = rows_of(300, 8)
    fits = [float((rows @ spherical_kmeans(rows, 10, 0, n).T).amax(1).mean()) for n in range(8)]
    assert all(later >= earlier - 1e-6 for earlier, later in itertools.pairwise(fits))


@pytest.mark.parametrize(("count", "distinct"), [(1, 1), (3, 3), (50, 1), (50, 2)])
def test_identical_and_few_rows(count: int, distinct: int) -> None:
    rows = rows_of(distinct, 5, 0)[torch.arange(count) % distinct]
    atoms = spherical_kmeans(rows, 8, seed=0)
    assert atoms.shape == (8, 5)
    torch.testing.assert_close((rows @ atoms.T).amax(1), torch.ones(count))


def test_same_seed_same_atoms() -> None:
    rows = rows_of(200, 8)
    assert spherical_kmeans(rows, 12, 5).equal(spherical_kmeans(rows, 12, 5))
    assert not spherical_kmeans(rows, 12, 5).equal(spherical_kmeans(rows, 12, 6))
