"""The language field as data: its codes, their file, and what it renders."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from scoup.field.field import Field as Field


def __getattr__(name: str) -> Any:
    """Load the class when it is asked for: the facts of a file are read without torch (``scoup.field.facts``)."""
    if name != "Field":
        raise AttributeError(f"module 'scoup.field' has no attribute {name!r}")
    from scoup.field.field import Field

    return Field
