"""The folder of the cache, on each platform."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from scoup.models.word_cache import cache_folder


@pytest.mark.parametrize(("platform", "variables", "expected"), [
    ("linux", {}, "home/.cache/scoup"),
    ("linux", {"XDG_CACHE_HOME": "/xdg"}, "/xdg/scoup"),
    ("linux", {"XDG_CACHE_HOME": "relative"}, "home/.cache/scoup"),
    ("darwin", {"XDG_CACHE_HOME": "/xdg"}, "home/Library/Caches/scoup"),
    ("win32", {}, "home/AppData/Local/scoup"),
    ("win32", {"LOCALAPPDATA": "/local"}, "/local/scoup"),
    ("win32", {"SCOUP_CACHE": "/own", "LOCALAPPDATA": "/local"}, "/own"),
    ("linux", {"SCOUP_CACHE": "own", "XDG_CACHE_HOME": "/xdg"}, "own"),
])  # fmt: skip
@pytest.mark.skipif(sys.platform == "win32", reason="these paths are not absolute there")
def test_places(
    monkeypatch: pytest.MonkeyPatch, platform: str, variables: dict[str, str], expected: str
) -> None:
    for name in ("SCOUP_CACHE", "XDG_CACHE_HOME", "LOCALAPPDATA"):
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(sys, "platform", platform)
    monkeypatch.setattr(Path, "home", lambda: Path("home"))
    assert cache_folder() == Path(expected)


def test_a_user_without_a_home(monkeypatch: pytest.MonkeyPatch) -> None:
    def homeless() -> Path:
        raise RuntimeError("no home")

    for name in ("SCOUP_CACHE", "XDG_CACHE_HOME", "LOCALAPPDATA"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(Path, "home", homeless)
    assert cache_folder() is None
