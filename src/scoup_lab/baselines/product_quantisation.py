"""Product quantisation of embeddings: the vector cut into parts, each the number of the nearest of 256 centroids.

Dr. Splat keeps its features so. K-means is scipy's; nothing depends on faiss, whose ``IndexPQ`` does the same.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
import torch
from scipy.cluster.vq import kmeans2, vq
from torch import Tensor

from scoup.base import InputError

CENTROIDS = 256  # a byte a part
ITERATIONS = 12  # of k-means
SAMPLED = 16384  # rows that k-means learns from, at most


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
        codes = [vq(columns, of_part)[0] for columns, of_part in zip(parts, self.centroids, strict=True)]
        return torch.from_numpy(np.stack(codes, 1).astype(np.uint8))

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
    centroids = []
    for columns in _cut(array, n_parts):
        start = columns[rng.choice(len(columns), min(CENTROIDS, len(columns)), replace=False)]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a centroid that no row is nearest to stays where it is
            centroids.append(kmeans2(columns, start, iterations, minit="matrix")[0])
    return ProductQuantiser(np.stack(centroids))


def _cut(rows: np.ndarray, n_parts: int) -> np.ndarray:
    """Return [M, R, D / M]."""
    return rows.reshape(len(rows), n_parts, -1).transpose(1, 0, 2)
