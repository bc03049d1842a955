"""Constants left out one at a time, for ``benchmarks answers --without``."""

from __future__ import annotations

from contextlib import AbstractContextManager
from types import ModuleType
from typing import Any
from unittest.mock import patch

from scoup.base import looked_up
from scoup.query import constants as of_query
from scoup.uplift import constants as of_uplift

LEFT_OUT: dict[ModuleType, dict[str, float]] = {
    of_uplift: {
        "AUTO_SIDE": 1 << 30, "SHARPNESS": 0.0, "LEAST_DEVIATION": 1e-9, "SAMPLED_VIEWS": 1 << 30,
        "LEAST_SHARE": 0.0, "MASS": 1.0, "MOST_VIEWS": 1 << 30, "LEAST_REGIONS": 1, "INSIDE": 1.0, "PER_SIZE": 1e9,
        "SPACING": 0.0, "KEPT": 0.0,
    },
    of_query: {
        "HUB_SHARE": 0.0, "FEW_REGIONS": 0.0, "UNSTABLE": 0.0, "LEAST_STABILITY": 1e-9, "MOST_GAP": 1e9,
        "MOST_TOGETHER": 1, "SAME_GAUSSIANS": 1.0, "MOST_COVERED": 1.0, "RIVAL": 0.0,
        "AGREEMENT": 0.0, "PRESENT_FROM": 0.0, "OTHER_NAME": 1e9, "SAME_WORD": 2.0,
    },
}  # fmt: skip
"""By room: constant -> the value at which it has no effect. Others cannot be left out, or count in no scene."""
WITHOUT = "without "
"""Begins the name of the default way without a constant."""


def table_of_constant(name: str) -> ModuleType:
    """Return the table that can leave a constant out; an error for none."""
    return looked_up("constant", name, {name: table for table, of in LEFT_OUT.items() for name in of})


def left_out(name: str) -> AbstractContextManager[Any]:
    """Give a constant the value at which it has no effect, while a block runs: modules read it when they need it."""
    table = table_of_constant(name)
    return patch.object(table, name, LEFT_OUT[table][name])
