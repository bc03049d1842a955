"""Dataclasses of tensors as one line: shapes and types in place of numbers."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

_LONGEST = 60  # characters of a value that is not a tensor


def brief(self: Any) -> str:
    """Return a short ``repr`` of a dataclass: its fields, tensors by type and shape. Assign it to ``__repr__``."""
    parts = (f"{field.name}={_value(getattr(self, field.name))}" for field in fields(self) if field.repr)
    return f"{type(self).__name__}({', '.join(parts)})"


def _value(value: Any) -> str:
    shape, kind = getattr(value, "shape", None), getattr(value, "dtype", None)
    if shape is not None and kind is not None:
        return f"{str(kind).removeprefix('torch.')} {list(shape)}"
    if isinstance(value, (tuple, list)) and any(hasattr(each, "shape") for each in value):
        return "[" + ", ".join(map(_value, value)) + "]"
    text = repr(value)
    return text if len(text) <= _LONGEST else text[: _LONGEST - 3] + "..."
