"""Memory that a process has freed and still holds: programs that run for long give it back to the system."""

from __future__ import annotations

import ctypes
import sys
from functools import cache
from typing import Any


def give_back_freed_memory() -> None:
    """Let the C library give back what was freed between blocks that are still used. Takes milliseconds.

    Without it the blocks of many sizes that pictures and queries take leave ever more gaps. Only glibc has a way to
    say so; elsewhere nothing happens.
    """
    trim = _trim()
    if trim is not None:
        trim(0)


@cache
def _trim() -> Any:
    if not sys.platform.startswith("linux"):
        return None
    return getattr(ctypes.CDLL(None), "malloc_trim", None)
