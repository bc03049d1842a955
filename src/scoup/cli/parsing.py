"""From arguments to a verb: which one, with which options, and how its help is laid out."""

from __future__ import annotations

import importlib
import inspect
import re
import shutil
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from operator import or_
from typing import Annotated, Any

import tyro

from scoup.cli.option_groups import REGISTRY

_WIDEST = 120  # columns: longer lines of text are hard to read
_MARGIN = "  "  # as in the frames around options; also keeps tyro from joining the lines


@dataclass(frozen=True)
class Family:
    """Verbs by name, or families of verbs.

    Attributes:
        description: for the help; its first paragraph for lists.
        verbs: where each is, "module:name" of a dataclass or of a further family; imported when it is used.
        others: where a function from any other name to a verb, or None, is; "" if there are no others.
    """

    description: str
    verbs: Mapping[str, str]
    others: str = ""

    def load(self, name: str) -> type | Family:
        """Import a verb, or a family of verbs."""
        return _imported(self.verbs[name])

    def find(self, name: str) -> type | Family | None:
        """Return what a name means; None if nothing."""
        if name in self.verbs:
            return self.load(name)
        return _imported(self.others)(name) if self.others and name[:1].isalnum() else None


def _imported(place: str) -> Any:
    module, _, attribute = place.partition(":")
    return getattr(importlib.import_module(module), attribute)


def parse(arguments: Sequence[str], family: Family, program: str) -> Any:
    """The verb that the arguments name, with its options.

    Raises:
        SystemExit: after printing help, or why the arguments cannot be parsed.
    """
    name, rest = (arguments[0], arguments[1:]) if arguments else ("", ())
    verb = family.find(name)
    if verb is not None:
        if isinstance(verb, Family):
            return parse(rest, verb, f"{program} {name}")
        return _parse(verb, f"{program} {name}", _text(verb), rest)
    # Either the list of verbs is wanted, or there is no such verb: neither needs to know their options.
    listed = [
        Annotated[_Listed, tyro.conf.subcommand(name, description=_paragraphs(_text(family.load(name)))[0])]
        for name in family.verbs
    ]
    return _parse(reduce(or_, listed), program, family.description, arguments or ["--help"])


def in_one_line(box: str) -> str:
    """Return what the parser prints in a frame of several lines, up to the frame's first rule."""
    lines = [line.strip("│ ") for line in box.splitlines() if not line.startswith(("╭", "╰"))]
    parts = re.split(r"\n[─-]+\n", "\n".join(lines))
    # Where the terminal has no letters for frames, the title is the first part.
    said = parts[0 if "╭" in box else 1]
    return " ".join(said.split())


@dataclass(frozen=True)
class _Listed:
    """A verb in a list of verbs."""


def _parse(kind: Any, program: str, description: str, arguments: Sequence[str]) -> Any:
    return tyro.cli(
        kind,
        prog=program,
        description=_wrapped(description),
        args=arguments,
        config=(tyro.conf.FlagCreatePairsOff,),
        compact_help=False,
        registry=REGISTRY,
    )


def _text(verb: type | Family) -> str:
    return verb.description if isinstance(verb, Family) else verb.__doc__ or ""


def _paragraphs(text: str) -> list[str]:
    """Join the lines of each paragraph, except indented ones."""
    parts = inspect.cleandoc(text).split("\n\n")
    return [part if part.startswith(" ") else " ".join(part.split()) for part in parts]


def _wrapped(text: str) -> str:
    """The text in lines that fit the terminal."""
    width = min(shutil.get_terminal_size().columns, _WIDEST)
    how = {"initial_indent": _MARGIN, "subsequent_indent": _MARGIN, "break_on_hyphens": False}
    return "\n".join(
        textwrap.indent(part, _MARGIN) if part.startswith(" ") else textwrap.fill(part, width, **how)
        for part in _paragraphs(text)
    )
