"""The tables of constants: what can be left out is in them, and modules read them when they need them."""

from __future__ import annotations

import importlib
import pkgutil
from types import ModuleType

import pytest

import scoup.extract
import scoup.query
import scoup.uplift
from scoup.extract import constants as of_extract
from scoup.query import constants as of_query
from scoup.uplift import constants as of_uplift


def names_of(table: ModuleType) -> set[str]:
    return {name for name in vars(table) if name.isupper() and name != "WITHOUT"}


@pytest.mark.parametrize("table", [of_uplift, of_query], ids=["uplift", "query"])
def test_what_can_be_left_out_is_in_the_table(table: ModuleType) -> None:
    assert set(table.WITHOUT) < names_of(table)
    for name, neutral in table.WITHOUT.items():
        assert getattr(table, name) != neutral


@pytest.mark.parametrize(
    ("room", "table"),
    [(scoup.uplift, of_uplift), (scoup.extract, of_extract), (scoup.query, of_query)],
    ids=["uplift", "extract", "query"],
)
def test_no_module_keeps_a_copy(room: ModuleType, table: ModuleType) -> None:
    """Which would stay as it is when a constant is left out."""
    found = {
        (module.name, name)
        for module in pkgutil.iter_modules(room.__path__, f"{room.__name__}.")
        if module.name != table.__name__
        for name in vars(importlib.import_module(module.name)).keys() & names_of(table)
        if getattr(importlib.import_module(module.name), name) is getattr(table, name)
    }
    assert not found
