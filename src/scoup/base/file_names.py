"""Names of files and folders for what verbs write."""

from __future__ import annotations

from collections.abc import Iterable

_MOST_BYTES = 80  # of a name: leaves space for suffixes and for the marks of temporary files


def slug(text: str) -> str:
    """Return a file name for a text: letters, digits, underscores and dashes."""
    kept = "".join(char if char.isalnum() or char == "_" else "-" for char in text.lower()).strip("-")
    while "--" in kept:
        kept = kept.replace("--", "-")
    return kept.encode("utf-8", "ignore")[:_MOST_BYTES].decode("utf-8", "ignore") or "text"


def unique_slugs(texts: Iterable[str]) -> list[str]:
    """Return slugs of the texts, numbered where they would be equal."""
    names: list[str] = []
    for text in texts:
        name, number = slug(text), 1
        candidate = name
        while candidate in names:
            number += 1
            candidate = f"{name}-{number}"
        names.append(candidate)
    return names
