"""The things of a scene as the page lists, names and measures them."""

from __future__ import annotations

from typing import Any

from scoup.field.language_field import LanguageField
from scoup.query.matching import compare_things
from scoup.query.named import best_words, voted_names
from scoup.query.question import Question


def page_things(field: LanguageField, vocabulary: Question | None) -> list[dict[str, Any]]:
    """Return every thing as plain JSON values, with its name: one that a model gave it, or the word of a vocabulary
    that fits it best.

    Args:
        field: to be shown.
        vocabulary: the words that things are named by; None: things have numbers only.
    """
    known = None if vocabulary is None else compare_things(field, vocabulary)
    words: list[int] = []
    if vocabulary is not None and known is not None:
        words = best_words(known.embeddings @ vocabulary.queries.float().cpu().T)[:, 0].tolist()
    rows, voted = [], voted_names(field)
    for thing in field.things():
        record, number = thing.to_dict(), thing.number or 0
        named = None if vocabulary is None else vocabulary.texts[words[number]]
        if number in voted:
            named = voted[number][0][0]
        rows.append(
            {
                "number": number,
                "level": field.level_index(thing.level),
                "parent": thing.parent,
                "name": named,
                **{name: record[name] for name in ("position", "box", "gaussians")},
                "views": thing.n_regions,
            }
        )
    return rows
