"""The kinds of scenes that the demo can make."""

from __future__ import annotations

from scoup.demo.layouts.hall import HALL
from scoup.demo.layouts.layout import Layout
from scoup.demo.layouts.shelves import SHELVES
from scoup.demo.layouts.table import TABLE
from scoup.demo.layouts.yard import YARD
from scoup.errors import UnknownNameError

LAYOUTS: dict[str, Layout] = {layout.name: layout for layout in (TABLE, SHELVES, HALL, YARD)}

__all__ = ["LAYOUTS", "Layout", "find_layout"]


def find_layout(name: str) -> Layout:
    """The layout of that name.

    Raises:
        UnknownNameError: there is none.
    """
    if name not in LAYOUTS:
        raise UnknownNameError("layout", name, list(LAYOUTS), "the demo")
    return LAYOUTS[name]
