"""Counts in messages: a number and what it counts, in the singular or the plural."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

T = TypeVar("T")


def counted(count: int, thing: str, things: str = "") -> str:
    """Return a number and what it counts: "1 view", "2 views", "90,854 Gaussians"; ``things`` is the plural where that
    is not the singular with an s."""
    return f"{count:,} {thing if count == 1 else things or thing + 's'}"


def none_of(count: int, thing: str) -> str:
    """Return the subject of a sentence that denies something of all: "none of the 4 views", "no view" where there is
    one.
    """
    return f"no {thing}" if count == 1 else f"none of the {count:,} {thing}s"


def share_of(count: int, total: int, thing: str, things: str = "") -> str:
    """Return some of all: "1 of 8 views", "8 of 8 views", and "the only view" where there is one; its verb is that of
    count."""
    return f"the only {thing}" if total == 1 else f"{count:,} of {counted(total, thing, things)}"


def verb(count: int, singular: str, plural: str) -> str:
    """Return the form of a verb, or of what begins with it, that a number of things takes."""
    return singular if count == 1 else plural


def listed(names: Sequence[str], count: int = 3) -> str:
    """Return the first few of some names: "a, b, c, ..."."""
    return ", ".join(names[:count]) + (", ..." if len(names) > count else "")


def spread(items: Sequence[T], most: int) -> list[T]:
    """Return at most ``most`` of the items, evenly spread."""
    count = min(most, len(items))
    return [items[(2 * i + 1) * len(items) // (2 * count)] for i in range(count)]
