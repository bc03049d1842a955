"""The page of all verbs and their options: the help of each; ``python tools/document_verbs.py`` prints it."""

from __future__ import annotations

import contextlib
import io
import os
from collections.abc import Iterator
from unittest.mock import patch

from scoup.cli import Family
from scoup.cli.app import SCOUP, run

HEAD = """# Verbs and their options

Made from the program itself: `scoup VERB --help` shows the same in the terminal. Exit codes: 0 done, 1 a fault of the
program, 2 bad input, 130 interrupted, 143 terminated.
"""
COLUMNS = "100"


def page() -> str:
    """Return the page as Markdown."""
    return HEAD + "".join(section(verb) for verb in verbs(SCOUP))


def verbs(family: Family, before: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    """Yield the words that call each verb, such as ("eval", "lerf-ovs")."""
    for name in family.verbs:
        verb = family.load(name)
        if isinstance(verb, Family):
            yield from verbs(verb, (*before, name))
        else:
            yield (*before, name)


def section(verb: tuple[str, ...]) -> str:
    """Return the section of a verb: its help."""
    said = io.StringIO()
    with contextlib.redirect_stdout(said), patch.dict(os.environ, COLUMNS=COLUMNS):
        run([*verb, "--help"])
    lines = "\n".join(line.rstrip() for line in said.getvalue().splitlines())
    return f"\n## `scoup {' '.join(verb)}`\n\n```text\n{lines}\n```\n"


if __name__ == "__main__":
    print(page())
