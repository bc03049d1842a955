"""Names of files and folders for what verbs write."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable

_MOST_BYTES = 80  # of a name: leaves space for suffixes and for the names of temporary files
_LONGEST = 200  # bytes of a name that a hidden one repeats; file systems allow 255


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


def hidden_name(name: str, kind: str) -> str:
    """Return the name of a hidden file beside a file of this name: ``.NAME.KIND``."""
    if len(name.encode("utf-8", "replace")) > _LONGEST:
        name = hashlib.sha256(name.encode("utf-8", "replace")).hexdigest()
    return f".{name}.{kind}"
