"""Product quantisation against its definition."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from messages import refuses
from scoup_lab.baselines.product_quantisation import fit_product_quantiser


def rows(count: int, dim: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(count, dim, generator=torch.Generator().manual_seed(seed))


def test_codes_are_the_nearest_centroids_of_each_part() -> None:
    data = rows(600, 12)
    quantiser = fit_product_quantiser(data, 3)
    assert quantiser.centroids.shape == (3, 256, 4)
    codes = quantiser.encode(data[:50])
    assert codes.dtype == torch.uint8
    for row, code in zip(data[:50].numpy(), codes.numpy(), strict=True):
        for part in range(3):
            distances = ((quantiser.centroids[part] - row[part * 4 : part * 4 + 4]) ** 2).sum(1)
            assert distances[code[part]] == pytest.approx(distances.min(), abs=1e-5)
    decoded = quantiser.decode(codes).numpy()
    for row, code in zip(decoded, codes.numpy(), strict=True):
        expected = np.concatenate([quantiser.centroids[part, code[part]] for part in range(3)])
        np.testing.assert_array_equal(row, expected)


def test_k_means_only_improves() -> None:
    data = rows(900, 8)
    losses = [
        float((q.decode(q.encode(data)) - data).square().sum(1).mean())
        for q in (fit_product_quantiser(data, 2, iterations=n) for n in (1, 4, 12))
    ]
    assert losses == sorted(losses, reverse=True)
    assert losses[-1] < 0.9 * losses[0]


def test_as_many_centroids_as_rows_lose_nothing() -> None:
    data = rows(40, 6)
    quantiser = fit_product_quantiser(data, 2)
    assert torch.equal(quantiser.decode(quantiser.encode(data)), data)
    alike = torch.ones(5, 6)  # more centroids than different rows
    quantiser = fit_product_quantiser(alike, 3)
    assert torch.equal(quantiser.decode(quantiser.encode(alike)), alike)


def test_the_seed_decides() -> None:
    data = rows(500, 8)
    first, again, other = (fit_product_quantiser(data, 4, seed).centroids for seed in (1, 1, 2))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_no_rows() -> None:
    with refuses():
        fit_product_quantiser(rows(0, 8), 2)
