"""The page of all verbs and their options, made from the code; ``python tools/document_verbs.py`` prints it."""

from __future__ import annotations

import inspect
import types
from collections.abc import Iterator
from dataclasses import MISSING, Field, fields
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from scoup.cli.app import SCOUP
from scoup.cli.family import Family
from scoup.cli.option_groups import attribute_texts, option_groups

HEAD = """# Verbs and their options

Made from the program itself. `scoup VERB --help` shows the same in the terminal. Exit codes: 0 done, 1 a fault of the
program, 2 bad input, 130 interrupted, 143 terminated.
"""
PLAIN = {int: "INT", float: "NUMBER", str: "TEXT", Path: "PATH"}


def page() -> str:
    """Return the page as Markdown."""
    return HEAD + "".join(section(name, verb) for name, verb in verbs(SCOUP, "scoup"))


def verbs(family: Family, program: str) -> Iterator[tuple[str, type]]:
    """Yield every verb with the words that call it, such as "scoup eval lerf-ovs"."""
    for name in family.verbs:
        verb = family.load(name)
        if isinstance(verb, Family):
            yield from verbs(verb, f"{program} {name}")
        else:
            yield f"{program} {name}", verb


def section(name: str, verb: type) -> str:
    """Return the section of a verb: its docstring, and a table of options per group."""
    hints, texts = get_type_hints(verb, include_extras=True), attribute_texts(verb)
    known = {field.name: field for field in fields(verb)}
    groups = option_groups(verb)
    grouped = {option for names in groups.values() for option in names}
    lists = {"": [option for option in known if option not in grouped], **groups}
    parts = [f"\n## `{name}`\n\n{inspect.cleandoc(verb.__doc__ or '')}\n"]
    for title, names in lists.items():
        rows = [row(known[option], hints[option], texts[option]) for option in names]
        if rows:
            heading = f"\n**{title}**\n" if title else ""
            parts.append(f"{heading}\n| option | default | meaning |\n| --- | --- | --- |\n" + "".join(rows))
    return "".join(parts)


def row(field: Field[Any], hint: Any, text: str) -> str:
    """Return a row of a table of options."""
    cells = f"`{written(field, hint)}`", default_of(field), text.replace("<", "&lt;")
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |\n"


def written(field: Field[Any], hint: Any) -> str:
    """Return an option as it is written on the command line, with its value."""
    name, value, positional = field.name.replace("_", "-"), "", False
    for note in notes_of(hint):
        name = getattr(note, "name", None) or name
        value = getattr(note, "metavar", None) or value
        positional = positional or "POSITIONAL" in str(note).upper()
    kind = plain_type(hint)
    if positional:
        return value or name.upper()
    if kind is bool:
        return f"--{name}, --no-{name}" if field.default is True else f"--{name}"
    return f"--{name} {value or shown_type(kind)}"


def notes_of(hint: Any) -> Iterator[Any]:
    """Yield the annotations of a type, the innermost first."""
    if get_origin(hint) is Annotated:
        inner, *notes = get_args(hint)
        yield from notes_of(inner)
        yield from notes


def plain_type(hint: Any) -> Any:
    """Return a type without annotations, and without None."""
    while get_origin(hint) is Annotated:
        hint = get_args(hint)[0]
    if get_origin(hint) in (Union, types.UnionType):
        kinds = [kind for kind in get_args(hint) if kind is not types.NoneType]
        return plain_type(kinds[0]) if len(kinds) == 1 else hint
    return hint


def shown_type(kind: Any) -> str:
    """Return the placeholder of an option's value."""
    origin = get_origin(kind)
    if origin is Literal:
        return "{" + ",".join(map(str, get_args(kind))) + "}"
    if origin is tuple:
        inner = shown_type(plain_type(get_args(kind)[0]))
        return (
            f"{inner} [{inner} ...]"
            if Ellipsis in get_args(kind)
            else " ".join([inner] * len(get_args(kind)))
        )
    return PLAIN.get(kind, "VALUE")


def default_of(field: Field[Any]) -> str:
    """Return the default of an option; "" for None, False and empty ones."""
    if field.default is MISSING:
        return "required"
    if field.default is None or field.default is False or field.default in ((), ""):
        return ""
    if isinstance(field.default, bool):
        return "on"
    if isinstance(field.default, tuple):
        return f"`{' '.join(map(str, field.default))}`"
    return f"`{field.default}`"


if __name__ == "__main__":
    print(page())
