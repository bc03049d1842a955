"""Callbacks by which long work reports progress."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

Item = TypeVar("Item")

Progress = Callable[[str, int, int], None]
"""``progress(stage, done, total)``: called with done = 0 before the first step and after every step."""


def no_progress(stage: str, done: int, total: int) -> None:
    """Report nothing."""


def reported(items: Iterable[Item], stage: str, total: int, progress: Progress) -> Iterator[Item]:
    """Yield items as they come; each counts as done when the next one is requested."""
    progress(stage, 0, total)
    for done, item in enumerate(items, start=1):
        yield item
        progress(stage, done, total)
