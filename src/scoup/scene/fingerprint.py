"""The fingerprint of a geometry, computed without torch."""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np
from numpy.typing import NDArray


def geometry_fingerprint(
    means: NDArray[Any],  # [N, 3] float32
    quats: NDArray[Any],  # [N, 4] float32
    scales: NDArray[Any],  # [N, 3] float32
    opacities: NDArray[Any],  # [N] float32
) -> str:
    """Return the SHA-256 of the columns that decide all blending weights.

    Colour is left out: a recoloured scene keeps its language field.
    """
    digest = hashlib.sha256(f"scoup-geometry-1:{len(means)}".encode())
    for array in (means, quats, scales, opacities):
        digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()
