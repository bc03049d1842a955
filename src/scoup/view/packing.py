"""Arrays for the page: few bytes per number, component by component, gzipped."""

from __future__ import annotations

import gzip
import json
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors.numpy import save

_STEPS_24 = 2**24 - 1
_STEPS_16 = 2**16 - 1
_STEPS_8 = 2**8 - 1


def packed(tensors: Mapping[str, np.ndarray], metadata: Mapping[str, Any], effort: int = 6) -> bytes:
    """Return a gzipped safetensors file; ``metadata`` becomes JSON under the key "scoup".

    Equal input gives equal bytes. ``effort`` is 1, fast, to 9, small.
    """
    contiguous = {name: np.ascontiguousarray(array) for name, array in tensors.items()}
    plain = save(contiguous, {"scoup": json.dumps(metadata, separators=(",", ":"))})
    return gzip.compress(plain, effort, mtime=0)


def byte_planes(values: NDArray[np.float64]) -> tuple[NDArray[np.uint8], list[float], list[float]]:
    """Return columns [M, C] as 24-bit fractions of their range, most significant bytes first: [3, C, M].

    Returns:
        The bytes, the least and the greatest value of each column.
    """
    if not len(values):
        return np.zeros((3, values.shape[1], 0), np.uint8), [0.0] * values.shape[1], [0.0] * values.shape[1]
    low, high = values.min(0), values.max(0)
    steps = np.rint((values - low) / np.where(high > low, high - low, 1.0) * _STEPS_24).astype(np.uint32).T
    planes = [(steps >> shift & 0xFF).astype(np.uint8) for shift in (16, 8, 0)]
    return np.stack(planes), low.tolist(), high.tolist()


def fractions(values: NDArray[np.floating], low: float, high: float) -> NDArray[np.uint8]:
    """Return values as 255ths of the way from one end to the other; beyond the ends counts as at the end."""
    extent = high - low if high > low else 1.0
    return np.rint(((values - low) / extent).clip(0, 1) * _STEPS_8).astype(np.uint8)


def fine_fractions(values: NDArray[np.floating], most: float) -> NDArray[np.uint16]:
    """Return values from 0 to ``most`` as 65535ths of it."""
    return np.rint(values / (most or 1.0) * _STEPS_16).astype(np.uint16)
