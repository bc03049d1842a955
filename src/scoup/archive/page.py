"""The results of an archive, as a page with pictures."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from urllib.parse import quote

import torch

from scoup.archive.found_things import FoundThing
from scoup.base import ScoupError, ScoupWarning, html
from scoup.field import relative_place
from scoup.pictures import Picture
from scoup.query import Thing, draw_things

_FOUND = """{% extends "page" %}{% macro cards(found) %}<ul>
{% for thing, picture, link in found %}
<li>{% if picture is not none %}<img alt="" src="{{ picture }}">{% endif %}<b>{{ thing.text }}</b> <small>
{{- "" if thing.score is none else "%.2f" % thing.score }} {{ thing.certainty or "" }}<br>
{%- if link %}<a href="{{ link }}">{% endif %}{{ thing.describe() }}{% if link %}</a>{% endif %}
{%- for name, value in thing.columns.items() %}<br>{{ name }} = {{ value }}{% endfor %}</small></li>
{% endfor %}</ul>{% endmacro %}{% block body %}{{ cards(found) }}
{% if doubtful %}<details><summary>{{ doubtful | length }} doubtful</summary>{{ cards(doubtful) }}</details>{% endif %}
{% endblock %}"""


def results_page(title: str, results: Sequence[FoundThing], path: Path) -> str:
    """Return a page, to be written to ``path``, of things with pictures where their fields are there and have cameras.
    Each links to its scan's page, if `scoup view` has exported one beside the field.

    Pictures are drawn now, for these things only: drawing all would slow adding scans, and most are never shown.
    """
    pictures = {
        (scan, number): picture
        for scan in dict.fromkeys(thing.scan for thing in results)
        for number, picture in _pictures([thing for thing in results if thing.scan == scan])
    }
    things = [(thing, pictures.get((thing.scan, thing.thing)), _link(thing, path)) for thing in results]
    sure, doubtful = (
        [card for card in things if (card[0].certainty == "doubtful") == wanted] for wanted in (False, True)
    )
    return html(_FOUND, title=title, found=sure, doubtful=doubtful)


def _pictures(results: Sequence[FoundThing]) -> Iterator[tuple[int, Picture]]:
    """Yield number and picture of things of one scan."""
    try:
        field = results[0].field()
        count = 0 if field.thing_table is None else len(field.thing_table)
        wanted = {thing.thing: thing.position for thing in results if thing.thing < count}
        things = [
            thing
            for thing in (Thing.of_table(field, [*wanted]) if wanted else ())
            if torch.equal(thing.position, wanted[thing.number or 0])
        ]
        if len(things) < len(results):
            warnings.warn(f"{field.path}: has changed; add it again", ScoupWarning, stacklevel=3)
        for thing, picture, *_ in draw_things(field, things, list(field.cameras or ())):
            yield thing.number or 0, picture
    except ScoupError as error:
        warnings.warn(f"no pictures of the scan {results[0].scan}: {error}", ScoupWarning, stacklevel=3)


def _link(thing: FoundThing, path: Path) -> str:
    """Return the address of a thing in its scan's page; "" without one."""
    exported = thing.field_path.with_suffix(".html")
    return f"{quote(relative_place(path, exported) or '')}#thing={thing.thing}" if exported.is_file() else ""
