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


@pytest.mark.parametrize(
    ("room", "table"), [(scoup.uplift, of_uplift), (scoup.extract, of_extract), (scoup.query, of_query)]
)
def test_what_can_be_left_out_is_in_the_table_alone(room: ModuleType, table: ModuleType) -> None:
    """A copy would stay as it is when a constant is left out."""
    names = {name for name in vars(table) if name.isupper() and name != "WITHOUT"}
    assert set(vars(table).get("WITHOUT", {})) < names
    for name, neutral in vars(table).get("WITHOUT", {}).items():
        assert getattr(table, name) != neutral
    for found in pkgutil.iter_modules(room.__path__, f"{room.__name__}."):
        module = importlib.import_module(found.name)
        copies = [name for name in vars(module).keys() & names if vars(module)[name] is vars(table)[name]]
        assert module is table or not copies, found.name
