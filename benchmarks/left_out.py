"""Constants left out one at a time, for ``benchmarks answers --without``."""

from __future__ import annotations

from contextlib import AbstractContextManager
from types import ModuleType
from typing import Any
from unittest.mock import patch

from scoup.base import looked_up
from scoup.query import constants as of_query
from scoup.uplift import constants as of_uplift

TABLES: tuple[ModuleType, ...] = (of_uplift, of_query)
"""The tables of constants, one per room: those that a ``WITHOUT`` names can be left out."""
WITHOUT = "without "
"""Begins the name of the default way without a constant."""


def table_of_constant(name: str) -> ModuleType:
    """Return the table that can leave a constant out; an error for none."""
    return looked_up("constant", name, {name: table for table in TABLES for name in table.WITHOUT})


def left_out(name: str) -> AbstractContextManager[Any]:
    """Give a constant the value at which it has no effect, while a block runs: modules read it when they need it."""
    table = table_of_constant(name)
    return patch.object(table, name, table.WITHOUT[name])
