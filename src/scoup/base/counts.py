"""Numbers of things in messages, in the singular where there is one."""

from __future__ import annotations


def counted(count: int, thing: str, things: str = "") -> str:
    """A number and what it counts: "1 view", "2 views", "90,854 Gaussians".

    Args:
        thing: in the singular.
        things: in the plural, where that is not the singular with an s.
    """
    return f"{count:,} {thing if count == 1 else things or thing + 's'}"


def none_of(count: int, thing: str) -> str:
    """The subject of a sentence that denies something of all: "none of the 4 views", "no view" where there is one."""
    return f"no {thing}" if count == 1 else f"none of the {count:,} {thing}s"
