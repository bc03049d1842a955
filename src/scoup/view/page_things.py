"""The things of a scene as the page lists, names and measures them."""

from __future__ import annotations

from typing import Any

from scoup.field.language_field import LanguageField
from scoup.query.question import Question
from scoup.query.thing_names import named_things


def page_things(field: LanguageField, vocabulary: Question | None) -> list[dict[str, Any]]:
    """Return every thing as plain JSON values, with its name, or None.

    Args:
        field: to be shown.
        vocabulary: the words that things are named by; None: things have numbers only.
    """
    rows = []
    for thing in named_things(field, vocabulary):
        record = thing.to_dict()
        rows.append(
            {
                "number": thing.number,
                "level": field.level_index(thing.level),
                "parent": thing.parent,
                "name": thing.text or None,
                **{name: record[name] for name in ("position", "box", "gaussians")},
                "views": thing.n_regions,
            }
        )
    return rows
