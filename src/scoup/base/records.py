"""Records of measurements as JSON that people can read too."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any


def record_text(record: Mapping[str, Any], depth: int = 1) -> str:
    """Return JSON (no NaN) with a line for each entry of a mapping; a list, however long, stays on one. ``depth`` is
    that of the indentation."""
    lines = []
    for key, value in record.items():
        nested = isinstance(value, Mapping) and value
        text = record_text(value, depth + 1) if nested else json.dumps(value, allow_nan=False)
        lines.append(f"{' ' * depth}{json.dumps(key)}: {text}")
    return "{\n" + ",\n".join(lines) + "\n" + " " * (depth - 1) + "}"


def rounded_vector(values: Sequence[float]) -> list[float]:
    """Return numbers rounded to six digits of the largest, but no coarser than three decimals."""
    largest = max((abs(value) for value in values), default=0.0)
    digits = 6 - math.ceil(math.log10(largest)) if largest > 0 and math.isfinite(largest) else 6
    return [round(value, max(3, digits)) for value in values]
