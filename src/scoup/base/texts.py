"""Words of messages: counts, lists, file names, short forms of values, text safe to print."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeVar

_LONGEST = 60  # characters of a value that is not a tensor

_MOST_BYTES = 80  # of a name: leaves space for suffixes and for the names of temporary files
_LONGEST_NAME = 200  # bytes of a name that a hidden one repeats; file systems allow 255

_CONTROLS = (
    *range(32),
    *range(127, 160),
    *range(0x2028, 0x202F),
    *range(0x2066, 0x206A),
    *range(0xD800, 0xE000),
)
_ESCAPES = {
    code: f"\\x{code:02x}" if code < 256 else f"\\u{code:04x}"
    for code in _CONTROLS
    if chr(code) not in "\n\t"
}

T = TypeVar("T")


def counted(count: int, thing: str, things: str = "") -> str:
    """Return a number and what it counts: "1 view", "2 views", "90,854 Gaussians"; ``things`` is the plural where that
    is not the singular with an s."""
    return f"{count:,} {thing if count == 1 else things or thing + 's'}"


def share_of(count: int, total: int, thing: str, things: str = "") -> str:
    """Return some of all: "1 of 8 views", "8 of 8 views", and "the only view" where there is one; of 0 "none of the 8
    views" and "no view". Its verb is that of count."""
    if not count:
        return f"no {thing}" if total == 1 else f"none of the {counted(total, thing, things)}"
    return f"the only {thing}" if total == 1 else f"{count:,} of {counted(total, thing, things)}"


def listed(names: Sequence[str], count: int = 3) -> str:
    """Return the first few of some names: "a, b, c, ..."."""
    return ", ".join(names[:count]) + (", ..." if len(names) > count else "")


def spread(items: Sequence[T], most: int) -> list[T]:
    """Return at most ``most`` of the items, evenly spread."""
    count = min(most, len(items))
    return [items[(2 * i + 1) * len(items) // (2 * count)] for i in range(count)]


def printable(text: str) -> str:
    """Return the text with control characters escaped, but for line feeds and tabs, and with what UTF-8 lacks.

    Names out of files may hold them. They could move the cursor of a terminal, or reverse the order of letters.
    """
    return text.translate(_ESCAPES)


def slug(text: str) -> str:
    """Return a file name for a text: letters, digits, underscores and dashes."""
    parts = "".join(char if char.isalnum() or char == "_" else " " for char in text.lower()).split()
    name = "-".join(parts)
    return name.encode("utf-8", "ignore")[:_MOST_BYTES].decode("utf-8", "ignore") or "text"


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
    if len(name.encode("utf-8", "replace")) > _LONGEST_NAME:
        name = hashlib.sha256(name.encode("utf-8", "replace")).hexdigest()
    return f".{name}.{kind}"


def brief(self: Any) -> str:
    """Return a short ``repr`` of a dataclass: its fields, tensors by type and shape. Assign it to ``__repr__``."""
    parts = (f"{field.name}={_value(getattr(self, field.name))}" for field in fields(self) if field.repr)
    return f"{type(self).__name__}({', '.join(parts)})"


def _value(value: Any) -> str:
    shape, kind = getattr(value, "shape", None), getattr(value, "dtype", None)
    if shape is not None and kind is not None:
        return f"{str(kind).removeprefix('torch.')} {list(shape)}"
    if isinstance(value, (tuple, list)) and any(hasattr(item, "shape") for item in value):
        return "[" + ", ".join(map(_value, value)) + "]"
    text = repr(value)
    return text if len(text) <= _LONGEST else text[: _LONGEST - 3] + "..."


def rounded_vector(values: Sequence[float], decimals: int = 3) -> list[float]:
    """Return numbers rounded to six digits of the largest, but no coarser than to some decimals."""
    largest = max((abs(value) for value in values), default=0.0)
    digits = 6 - math.ceil(math.log10(largest)) if largest > 0 and math.isfinite(largest) else 6
    return [round(value, max(decimals, digits)) for value in values]


def as_json(record: Any, indent: int | None = 2) -> str:
    """Return a record as JSON, which has no NaN and no infinity: they are null; without ``indent`` in one line."""
    separators = (",", ":") if indent is None else None
    plain, letters = _plain(record), indent is not None
    text = json.dumps(plain, indent=indent, separators=separators, ensure_ascii=letters, allow_nan=False)
    return text.encode("utf-8", "backslashreplace").decode()  # of file names in another encoding


def _plain(value: Any) -> Any:
    value = value.item() if hasattr(value, "item") else value
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, Mapping):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(each) for each in value]
    return str(value) if isinstance(value, Path) else value
