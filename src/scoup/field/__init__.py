"""The language field as data: codes, things, geometry, cameras, their file, and what they render. It answers nothing.

Names are loaded when first used: the facts of a file are read without torch.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from scoup.base import lazy_names

_HOMES = {
    "Cache": "scoup.field.cache",
    "Field": "scoup.field.field",
    "FieldInfo": "scoup.field.field_info",
    "LEAST_GAUSSIANS": "scoup.field.checks",
    "MOST_THINGS": "scoup.field.checks",
    "NO_THING": "scoup.field.thing_table",
    "NameTable": "scoup.field.thing_table",
    "ThingTable": "scoup.field.thing_table",
    "doubt_of": "scoup.field.facts",
    "part_sizes": "scoup.field.facts",
    "place_of": "scoup.field.container",
    "read_facts": "scoup.field.facts",
    "relative_place": "scoup.field.container",
    "relevancy": "scoup.field.cosines",
    "write_world": "scoup.field.container",
}

__all__ = [*_HOMES]  # pyright: ignore[reportUnsupportedDunderAll]

if TYPE_CHECKING:
    from scoup.field.cache import Cache as Cache
    from scoup.field.checks import LEAST_GAUSSIANS as LEAST_GAUSSIANS
    from scoup.field.checks import MOST_THINGS as MOST_THINGS
    from scoup.field.container import place_of as place_of
    from scoup.field.container import relative_place as relative_place
    from scoup.field.container import write_world as write_world
    from scoup.field.cosines import relevancy as relevancy
    from scoup.field.facts import doubt_of as doubt_of
    from scoup.field.facts import part_sizes as part_sizes
    from scoup.field.facts import read_facts as read_facts
    from scoup.field.field import Field as Field
    from scoup.field.field_info import FieldInfo as FieldInfo
    from scoup.field.thing_table import NO_THING as NO_THING
    from scoup.field.thing_table import NameTable as NameTable
    from scoup.field.thing_table import ThingTable as ThingTable

__getattr__ = lazy_names(__name__, _HOMES)
