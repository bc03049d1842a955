"""Records of measurements as JSON that people can read too."""

from __future__ import annotations

import math
from collections.abc import Sequence


def rounded_vector(values: Sequence[float]) -> list[float]:
    """Return numbers rounded to six digits of the largest, but no coarser than three decimals."""
    largest = max((abs(value) for value in values), default=0.0)
    digits = 6 - math.ceil(math.log10(largest)) if largest > 0 and math.isfinite(largest) else 6
    return [round(value, max(3, digits)) for value in values]
