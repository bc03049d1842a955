"""The language field as data: codes, things, geometry, cameras, their file, and what they render. It answers nothing.

Names are loaded when first used: the facts of a file are read without torch.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from scoup.base import lazy_names

_HOMES = {
    "Cache": "scoup.field.cache",
    "Field": "scoup.field.field",
    "FieldCodes": "scoup.field.cosines",
    "FieldInfo": "scoup.field.field_info",
    "GaussianCosines": "scoup.field.cosines",
    "LEAST_GAUSSIANS": "scoup.field.content",
    "MOST_THINGS": "scoup.field.checks",
    "NO_THING": "scoup.field.thing_table",
    "NameTable": "scoup.field.thing_table",
    "Own": "scoup.field.field",
    "PixelCosines": "scoup.field.cosines",
    "ThingTable": "scoup.field.thing_table",
    "Vectors": "scoup.field.renders",
    "checked_vectors": "scoup.field.renders",
    "inverse_code_norms": "scoup.field.code_sums",
    "number_of": "scoup.field.thing_table",
    "part_sizes": "scoup.field.sizes",
    "pixel_relevancy": "scoup.field.cosines",
    "place_of": "scoup.field.container",
    "read_facts": "scoup.field.facts",
    "relative_place": "scoup.field.container",
    "relevancy": "scoup.field.cosines",
    "render_codes": "scoup.field.renders",
    "render_depth": "scoup.field.renders",
    "state_of": "scoup.field.cache",
}

__all__ = [*_HOMES]  # pyright: ignore[reportUnsupportedDunderAll]

if TYPE_CHECKING:
    from scoup.field.cache import Cache as Cache
    from scoup.field.cache import state_of as state_of
    from scoup.field.checks import MOST_THINGS as MOST_THINGS
    from scoup.field.code_sums import inverse_code_norms as inverse_code_norms
    from scoup.field.container import place_of as place_of
    from scoup.field.container import relative_place as relative_place
    from scoup.field.content import LEAST_GAUSSIANS as LEAST_GAUSSIANS
    from scoup.field.cosines import FieldCodes as FieldCodes
    from scoup.field.cosines import GaussianCosines as GaussianCosines
    from scoup.field.cosines import PixelCosines as PixelCosines
    from scoup.field.cosines import pixel_relevancy as pixel_relevancy
    from scoup.field.cosines import relevancy as relevancy
    from scoup.field.facts import read_facts as read_facts
    from scoup.field.field import Field as Field
    from scoup.field.field import Own as Own
    from scoup.field.field_info import FieldInfo as FieldInfo
    from scoup.field.renders import Vectors as Vectors
    from scoup.field.renders import checked_vectors as checked_vectors
    from scoup.field.renders import render_codes as render_codes
    from scoup.field.renders import render_depth as render_depth
    from scoup.field.sizes import part_sizes as part_sizes
    from scoup.field.thing_table import NO_THING as NO_THING
    from scoup.field.thing_table import NameTable as NameTable
    from scoup.field.thing_table import ThingTable as ThingTable
    from scoup.field.thing_table import number_of as number_of

__getattr__ = lazy_names(__name__, _HOMES)
