"""Product quantisation of embeddings: the vector cut into parts, each the number of the nearest of 256 centroids.

Dr. Splat keeps its features so. Plain k-means in numpy; nothing depends on faiss, whose ``IndexPQ`` does the same.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from scoup.base.errors import InputError

CENTROIDS = 256  # a byte a part
ITERATIONS = 12  # of k-means
SAMPLED = 16384  # rows that k-means learns from, at most
_ROWS = 8192


@dataclass(frozen=True, eq=False)
class ProductQuantiser:
    """Learned centroids."""

    centroids: np.ndarray  # [M, C, D / M] float32, C <= 256 for each of M parts

    @property
    def n_parts(self) -> int:
        """M, bytes of a code."""
        return self.centroids.shape[0]

    def encode(self, rows: Tensor) -> Tensor:
        """Return [R, M] uint8 codes of rows [R, D]."""
        parts = _cut(rows.detach().cpu().float().numpy(), self.n_parts)
        codes = np.empty((len(rows), self.n_parts), np.uint8)
        for number in range(self.n_parts):
            for start in range(0, len(rows), _ROWS):
                block = parts[number, start : start + _ROWS]
                codes[start : start + _ROWS, number] = _nearest(block, self.centroids[number])[0]
        return torch.from_numpy(codes)

    def decode(self, codes: Tensor) -> Tensor:
        """Return [R, D] float32 rows of codes [R, M]."""
        numbers = codes.cpu().numpy()
        parts = [of_part[numbers[:, number]] for number, of_part in enumerate(self.centroids)]
        return torch.from_numpy(np.concatenate(parts, axis=1))


def fit_product_quantiser(
    rows: Tensor, n_parts: int, seed: int = 0, iterations: int = ITERATIONS
) -> ProductQuantiser:
    """Learn centroids of each part by k-means from a random start.

    ``rows``: [R, D] floating point, R >= 1; a sample of them is used if there are many.
    """
    array = rows.detach().cpu().float().numpy()
    if not len(array):
        raise InputError("product quantisation needs rows to learn from")
    rng = np.random.default_rng(seed)
    if len(array) > SAMPLED:
        array = array[np.sort(rng.choice(len(array), SAMPLED, replace=False))]
    centroids = [_k_means(part, rng, iterations) for part in _cut(array, n_parts)]
    return ProductQuantiser(np.stack(centroids))


def _cut(rows: np.ndarray, n_parts: int) -> np.ndarray:
    """Return [M, R, D / M]."""
    return rows.reshape(len(rows), n_parts, -1).transpose(1, 0, 2)


def _k_means(rows: np.ndarray, rng: np.random.Generator, iterations: int) -> np.ndarray:
    """Return [C, d] centroids, C = 256 or fewer where there are fewer rows."""
    count = min(CENTROIDS, len(rows))
    centroids = rows[rng.choice(len(rows), count, replace=False)].copy()
    for _ in range(iterations):
        nearest, distance = _nearest(rows, centroids)
        sizes = np.bincount(nearest, minlength=count)
        sums = np.zeros((count, rows.shape[1]))
        np.add.at(sums, nearest, rows)
        filled = sizes > 0
        centroids[filled] = (sums[filled] / sizes[filled, None]).astype(np.float32)
        # A centroid that nobody chose takes the place of a row that is badly served.
        empty = np.flatnonzero(~filled)
        centroids[empty] = rows[np.argsort(-distance, kind="stable")[: len(empty)]]
    return centroids


def _nearest(rows: np.ndarray, centroids: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the number of the nearest centroid of each row, the first of equals, and the squared distance to it."""
    squared = (centroids**2).sum(1)[None] - 2 * rows @ centroids.T
    nearest = squared.argmin(1)
    return nearest, squared[np.arange(len(rows)), nearest] + (rows**2).sum(1)
