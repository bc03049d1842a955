"""Fixtures of the viewer's tests."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest
from browser_support import need_browser
from tools.chromium import chromium

if TYPE_CHECKING:
    from playwright.sync_api import Browser


# Of a module, not of the session: as long as playwright runs, no other test of this process could run an event loop.
@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """Headless Chromium."""
    need_browser(page=False)
    with chromium() as opened:
        yield opened


@pytest.fixture
def built_page() -> None:
    """The page of this checkout; skips where it is not built."""
    need_browser()
