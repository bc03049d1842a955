"""Embeddings that take few values, such as those of a panoptic segmenter: one vector per class.

Where the different rows number no more than the atoms, the rows themselves are a codebook without loss, and one atom is
the whole code of a row: the vote of the uplift then counts classes. A codebook that is learned has no loss either, but
gets there with mixtures. Rounding is all that is left of the gradient, Adam takes it for a direction, and each value
ends as a mixture of K atoms, some of which serve other values too. Weights sum to 1 whatever the norm of the decoded
code, so that the vote counts a value by that norm (.65 to 1); and the K atoms kept of a Gaussian are too few for two
values.
"""

from __future__ import annotations

import torch
from torch import Tensor

from scoup.scene import SparseCodes, index_dtype, stable_products

SAME = 1e-6  # 1 - cosine up to which two rows are one value
LEAST_ROWS = 2  # rows of a value, on average, that make values classes


def value_codes(rows: Tensor, n_atoms: int, k: int) -> tuple[Tensor, SparseCodes] | None:
    """Return atoms [L, D], the values of unit rows [R, D] in the order of their first rows and then zeros, and codes of
    one atom of weight 1; None where the rows take too many values.

    Values must be no more than the atoms, and no more than half as many as the rows: where nearly every row has a
    vector of its own, one atom per row would leave the vote nothing to agree on.
    """
    distinct = distinct_rows(rows, min(n_atoms, len(rows) // LEAST_ROWS))
    if distinct is None:
        return None
    values, of_row = distinct
    atoms = rows.new_zeros(n_atoms, rows.shape[1])
    atoms[: len(values)] = values
    indices = torch.zeros(len(rows), k, dtype=torch.long, device=rows.device)
    weights = rows.new_zeros(len(rows), k)
    indices[:, 0], weights[:, 0] = of_row, 1.0
    return atoms, SparseCodes(indices.to(index_dtype(n_atoms)), weights, n_atoms)


def distinct_rows(rows: Tensor, most: int) -> tuple[Tensor, Tensor] | None:
    """Return the values [M, D] of unit rows [R, D] and the nearest value [R] int64 of each; None for M > ``most``.

    A row is a new value if none before it is within ``SAME``. Too many are mostly known after ``most`` + 1 rows.
    """
    values = rows[:0]
    for block in rows.split(most + 1):
        left = block if not len(values) else block[stable_products(block, values).amax(1) < 1 - SAME]
        while len(left):
            if len(values) == most:
                return None
            values = torch.cat([values, left[:1]])
            left = left[stable_products(left, left[:1])[:, 0] < 1 - SAME]
    nearest = [stable_products(block, values).argmax(1) for block in rows.split(most + 1) if len(block)]
    return values, torch.cat(nearest) if nearest else torch.zeros(0, dtype=torch.long, device=rows.device)
