"""Memory that was freed goes back to the system."""

from __future__ import annotations

import sys

import pytest

from scoup.base import freed_memory
from scoup.base.freed_memory import give_back_freed_memory
from scoup.base.measuring import resident_bytes


@pytest.mark.skipif(freed_memory._trim() is None, reason="the C library has no malloc_trim")
def test_gaps_go_back_to_the_system():
    blocks = [
        bytearray(60_000) for _ in range(4000)
    ]  # below the size from which blocks are mapped by themselves
    kept = blocks[::40]
    held = resident_bytes()
    del blocks
    give_back_freed_memory()
    left = resident_bytes()
    assert held is not None
    assert left is not None
    assert left < held - 150_000_000
    assert len(kept) == 100


def test_elsewhere_nothing_happens(monkeypatch):
    monkeypatch.setattr(sys, "platform", "win32")
    freed_memory._trim.cache_clear()
    try:
        give_back_freed_memory()
        assert freed_memory._trim() is None
    finally:
        freed_memory._trim.cache_clear()
