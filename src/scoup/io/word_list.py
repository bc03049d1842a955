"""A list of words in a text file."""

from __future__ import annotations

from pathlib import Path

from scoup.base import InputError, existing_file
from scoup.io.reading import read_text


def read_words(path: Path | None) -> tuple[str, ...]:
    """Read a list of words, one per line, without empty lines and repetitions; None contains no words."""
    if path is None:
        return ()
    text = read_text(existing_file(path, "a list of words"))
    words = tuple(dict.fromkeys(" ".join(line.split()) for line in text.splitlines() if line.strip()))
    if not words:
        raise InputError(f"{path}: contains no word; write one per line")
    return words
