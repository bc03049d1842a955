"""Arithmetic on CPU tensors whose result does not depend on the number of threads."""

from __future__ import annotations

import operator
from collections.abc import Callable
from functools import wraps
from typing import Any

import numpy as np
import torch
from torch import Tensor


def ordered_sum(values: Tensor, dim: int) -> Tensor:
    """Sums along one axis. torch may cut a long sum into one part a thread."""
    return torch.as_tensor(values.numpy().sum(dim))


def elementwise(function: Callable[..., Any]) -> Callable[..., Tensor]:
    """Return a function of operators that is called with arrays in place of tensors.

    torch would share out the numbers of a codebook to its threads, and on a busy machine these wait for each other much
    longer than the arithmetic takes.
    """

    @wraps(function)
    def call(*values: Any) -> Tensor:
        return torch.from_numpy(
            function(*(part.numpy() if isinstance(part, Tensor) else part for part in values))
        )

    return call


product, quotient = elementwise(operator.mul), elementwise(operator.truediv)


def square_root(values: Tensor) -> Tensor:
    """Square roots, the nearest numbers: torch's are one rounding off, by the build of torch."""
    return torch.from_numpy(np.sqrt(values.numpy()))


def take_rows(rows: Tensor, chosen: Tensor) -> Tensor:
    """[n, D]: some of the rows [R, D], by number [n]; an array, see ``elementwise``."""
    return torch.from_numpy(rows.numpy().take(chosen.numpy(), 0))


def unit(vectors: Tensor, otherwise: Tensor) -> Tensor:
    """[N, D] scaled to unit norm; rows of ``otherwise`` in place of those without a direction."""
    norms = square_root(ordered_sum(product(vectors, vectors), 1))[:, None]
    scaled = quotient(vectors, norms.clamp(min=1e-6))
    whole = norms > 1e-6
    return scaled if bool(whole.all()) else torch.where(whole, scaled, otherwise)
