"""How long work reports itself."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[str, int, int], None]
"""``progress(stage, done, total)``: called with done = 0 before the first step and after every step."""


def no_progress(stage: str, done: int, total: int) -> None:
    """Report nothing."""
