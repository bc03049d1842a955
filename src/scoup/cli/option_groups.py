"""Options in named groups in a verb's help, while the verb stays one flat dataclass."""

from __future__ import annotations

import ast
import inspect
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import MISSING, dataclass, fields, is_dataclass, replace
from functools import cache, reduce
from itertools import pairwise
from operator import or_
from types import NoneType
from typing import Annotated, Any, TypeVar, get_args, get_type_hints

import tyro
from tyro.constructors import (
    ConstructorRegistry,
    PrimitiveTypeInfo,
    StructConstructorSpec,
    StructFieldSpec,
    StructTypeInfo,
)

from scoup.cli.options import Common, arg

T = TypeVar("T")
METAVARS = {int: "INT", float: "NUMBER", str: "TEXT"}


def option_groups(verb: type) -> dict[str, list[str]]:
    """Title of each group of a verb -> names of its fields: its own groups first, then those of its bases.

    A field that a verb puts into another group than its base is in the verb's only.
    """
    groups: dict[str, list[str]] = {}
    placed: set[str] = set()
    for kind in verb.__mro__:
        own = vars(kind).get("option_groups", {})
        for title, names in own.items():
            groups.setdefault(title, []).extend(name for name in names.split() if name not in placed)
        placed |= {name for names in own.values() for name in names.split()}
    return groups


@dataclass(frozen=True)
class _Group:
    """A group as tyro sees it: something nested, whose title is the name of the field that holds it."""

    options: tuple[StructFieldSpec, ...]

    def __call__(self) -> None:
        """Never called: tyro asks that it could be."""


def _registry() -> ConstructorRegistry:
    registry = ConstructorRegistry()
    registry.struct_rule(_nest)
    registry.primitive_rule(_without_none)
    return registry


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


def _nest(info: StructTypeInfo) -> StructConstructorSpec | None:
    """The fields of a verb, or those of a group."""
    kind: Any = info.type
    if isinstance(kind, _Group):
        return StructConstructorSpec(dict, kind.options)
    if not (isinstance(kind, type) and issubclass(kind, Common)):
        return None
    options = {option.name: option for option in _options(kind)}
    groups = {
        title: _Group(tuple(options.pop(name) for name in names))
        for title, names in option_groups(kind).items()
    }

    def make(**values: Any) -> Any:
        for title in groups:
            values |= values.pop(_holder(title))
        return kind(**values)

    return StructConstructorSpec(make, (*options.values(), *map(_nested, groups, groups.values())))


def _nested(title: str, group: _Group) -> StructFieldSpec:
    kind: Any = Annotated[group, tyro.conf.OmitArgPrefixes, tyro.conf.arg(name=title)]
    return StructFieldSpec(_holder(title), kind, tyro.MISSING_NONPROP, helptext="")


def _holder(title: str) -> str:
    """Name of the field that holds a group: one that no option has."""
    return f"{title} group"


def _options(verb: type) -> Iterator[StructFieldSpec]:
    """The fields of a verb for tyro; what they mean comes from the texts under them."""
    hints, texts = get_type_hints(verb, include_extras=True), attribute_texts(verb)
    for field in fields(verb):
        default = tyro.MISSING_NONPROP if field.default is MISSING else field.default
        yield StructFieldSpec(field.name, hints[field.name], default, helptext=texts[field.name])


def attribute_texts(kind: type) -> dict[str, str]:
    """The text under each field of a dataclass and its bases, in one line each."""
    texts: dict[str, str] = {}
    for base in reversed(kind.__mro__):
        if not is_dataclass(base):
            continue
        texts |= {**_own_texts(base), **vars(base).get("borrowed_texts", {})}
    return texts


def borrow_options(settings: Any, names: str, **presets: Any) -> Callable[[type[T]], type[T]]:
    """Add fields of a dataclass of settings to a verb as options that are None by default, with the texts under them.

    The texts end with the values in ``settings`` and in ``presets`` that differ.
    """
    hints, texts = get_type_hints(type(settings)), attribute_texts(type(settings))

    def add(verb: type[T]) -> type[T]:
        borrowed: dict[str, str] = {}
        for name in names.split():
            value, kind = getattr(settings, name), hints[name]
            metavar = next(shown for known, shown in METAVARS.items() if known in (kind, *get_args(kind)))
            verb.__annotations__[name] = Annotated[kind | None, arg(metavar=metavar)]
            setattr(verb, name, None)
            others = {preset: getattr(other, name) for preset, other in presets.items()}
            differing = [f"{preset}: {other}" for preset, other in others.items() if other != value]
            default = "never" if value is None else value
            borrowed[name] = f"{texts[name]} Default: {'; '.join([str(default), *differing])}."
        verb.borrowed_texts = borrowed  # pyright: ignore[reportAttributeAccessIssue]
        return verb

    return add


def _own_texts(kind: type) -> dict[str, str]:
    return dict(_texts_under(_classes(kind.__module__)[kind.__qualname__].body))


@cache
def _classes(module: str) -> dict[str, ast.ClassDef]:
    """Return the classes of a module; ``inspect`` would parse its source for each of them."""
    tree = ast.parse(inspect.getsource(sys.modules[module]))
    return {node.name: node for node in tree.body if isinstance(node, ast.ClassDef)}


def _texts_under(body: Sequence[ast.stmt]) -> Iterator[tuple[str, str]]:
    for field, text in pairwise(body):
        match field, text:
            case (ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(said)))):
                yield name, " ".join(said.split())


REGISTRY = _registry()
"""For ``tyro.cli``: shows the options of every verb in its groups."""
