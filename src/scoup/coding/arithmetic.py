"""Arithmetic on CPU tensors by numpy, whose result does not depend on the number of threads.

torch would also share out the numbers of a codebook to its threads, and on a busy machine these wait for each other
much longer than the arithmetic takes.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor


def ordered_sum(values: Tensor, dim: int) -> Tensor:
    """Sum along one axis; torch may split a long sum by thread."""
    return torch.as_tensor(values.numpy().sum(dim))


def take_rows(rows: Tensor, chosen: Tensor) -> Tensor:
    """[n, D]: some of the rows [R, D], by number [n]."""
    return torch.from_numpy(rows.numpy().take(chosen.numpy(), 0))


def unit(vectors: Tensor, otherwise: Tensor) -> Tensor:
    """[N, D] scaled to unit norm; rows of ``otherwise`` in place of those without a direction."""
    values = vectors.numpy()
    norms = np.sqrt((values * values).sum(1, keepdims=True))
    return torch.from_numpy(np.where(norms > 1e-6, values / np.maximum(norms, 1e-6), otherwise.numpy()))
