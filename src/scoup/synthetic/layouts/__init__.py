"""The kinds of scenes that the demo can make."""

from __future__ import annotations

from scoup.base.errors import UnknownNameError
from scoup.synthetic.layouts.hall import HALL
from scoup.synthetic.layouts.layout import Layout
from scoup.synthetic.layouts.shelves import SHELVES
from scoup.synthetic.layouts.table import TABLE
from scoup.synthetic.layouts.yard import YARD

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
