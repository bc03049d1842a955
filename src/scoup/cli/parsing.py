"""From arguments to a verb: which one, with which options, and how its help is laid out."""

from __future__ import annotations

import ast
import inspect
import re
import shutil
import sys
import textwrap
from collections.abc import Sequence
from dataclasses import MISSING, dataclass, fields, is_dataclass, replace
from difflib import get_close_matches
from functools import cache, reduce
from itertools import pairwise
from operator import or_
from types import NoneType
from typing import Annotated, Any, get_args, get_type_hints

import tyro
from tyro.constructors import (
    ConstructorRegistry,
    PrimitiveTypeInfo,
    StructConstructorSpec,
    StructFieldSpec,
    StructTypeInfo,
)

from scoup.cli.family import Family
from scoup.cli.options import option_type

_WIDEST = 120  # columns: longer lines of text are hard to read
_MARGIN = "  "  # as in the frames around options; also keeps tyro from joining the lines


def parse(arguments: Sequence[str], family: Family, program: str) -> Any:
    """Return the verb that the arguments name, with its options.

    Raises:
        SystemExit: after printing help, or why the arguments cannot be parsed.
    """
    name, rest = (arguments[0], arguments[1:]) if arguments else ("", ())
    verb = family.find(name)
    if verb is not None:
        if isinstance(verb, Family):
            return parse(rest, verb, f"{program} {name}")
        return _parse(verb, f"{program} {name}", _text(verb), rest)
    if near := get_close_matches(name, family.verbs, 1):
        print(f"{program} {name}: there is no such verb; {program} {near[0]}?", file=sys.stderr)
        raise SystemExit(2)
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
    said = parts[0 if "╭" in box else 1 % len(parts)]
    return " ".join(said.split())


@dataclass(frozen=True)
class _Listed:
    """A verb in a list of verbs."""


def _parse(kind: Any, program: str, description: str, arguments: Sequence[str]) -> Any:
    registry = ConstructorRegistry()
    registry.struct_rule(_with_whole_texts)
    registry.primitive_rule(_without_none)
    return tyro.cli(
        kind,
        prog=program,
        description=_wrapped(description),
        args=arguments,
        config=(tyro.conf.FlagCreatePairsOff, tyro.conf.OmitArgPrefixes),
        compact_help=False,
        registry=registry,
    )


def _with_whole_texts(info: StructTypeInfo) -> StructConstructorSpec | None:
    """Read a dataclass as tyro does, but join the lines of the text under a field, which tyro would keep apart."""
    kind: Any = info.type
    if not is_dataclass(info.type) or kind.__module__.startswith("tyro."):
        return None
    hints, texts = get_type_hints(kind, include_extras=True), field_texts(kind)
    options = []
    for field in sorted(
        fields(kind), key=lambda field: field.name == "common"
    ):  # the options of all verbs come last
        default = field.default if field.default_factory is MISSING else field.default_factory()
        default = tyro.MISSING_NONPROP if default is MISSING else default
        options.append(
            StructFieldSpec(
                field.name, option_type(hints[field.name]), default, helptext=texts.get(field.name, "")
            )
        )
    return StructConstructorSpec(kind, tuple(options))


def _without_none(info: PrimitiveTypeInfo) -> Any:
    """Parse options that are None by default as their other type: nobody types None, and messages leave it out."""
    kinds = [kind for kind in get_args(info.type) if kind is not NoneType]
    if len(kinds) == len(get_args(info.type)):
        return None
    made = PrimitiveTypeInfo.make(reduce(or_, kinds), info.markers)
    spec: Any = ConstructorRegistry.get_primitive_spec(made)
    return replace(
        spec,
        is_instance=lambda value: value is None or spec.is_instance(value),
        str_from_instance=lambda value: ["None"] if value is None else spec.str_from_instance(value),
    )


def field_texts(kind: type) -> dict[str, str]:
    """Return the text under each field of a dataclass and of its bases, in one line."""
    texts: dict[str, str] = {}
    for base in reversed(kind.__mro__):
        known = _classes(base.__module__) if is_dataclass(base) else {}
        for field, text in pairwise(known[base.__name__].body if base.__name__ in known else ()):
            match field, text:
                case (ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(said)))):
                    texts[name] = " ".join(said.split())
    return texts


@cache
def _classes(module: str) -> dict[str, ast.ClassDef]:
    """Return the classes of a module; ``inspect`` would parse its source for each of them."""
    tree = ast.parse(inspect.getsource(sys.modules[module]))
    return {node.name: node for node in tree.body if isinstance(node, ast.ClassDef)}


def _text(verb: type | Family) -> str:
    return verb.description if isinstance(verb, Family) else verb.__doc__ or ""


def _paragraphs(text: str) -> list[str]:
    """Join the lines of each paragraph, except indented ones."""
    blocks = inspect.cleandoc(text).split("\n\n")
    return [block if block.startswith(" ") else " ".join(block.split()) for block in blocks]


def _wrapped(text: str) -> str:
    """Return the text in lines that fit the terminal."""
    width = min(shutil.get_terminal_size().columns, _WIDEST)
    how = {"initial_indent": _MARGIN, "subsequent_indent": _MARGIN, "break_on_hyphens": False}
    return "\n".join(
        textwrap.indent(block, _MARGIN) if block.startswith(" ") else textwrap.fill(block, width, **how)
        for block in _paragraphs(text)
    )
