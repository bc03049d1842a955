"""Files are on the disk before they get their names, and the names after that: a power cut leaves all or nothing."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from scoup.base.errors import WriteError
from scoup.base.outputs import atomic_file, atomic_path, staged


@pytest.fixture
def events(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, str]]:
    """What was flushed and renamed, in this order, by the contents of files and the names of folders."""
    monkeypatch.chdir(tmp_path)
    flush, rename, found = os.fsync, os.replace, []
    names = {}

    def flushed(descriptor: int) -> None:
        flush(descriptor)
        found.append(("flush", names.get(os.fstat(descriptor).st_ino, "folder")))

    def renamed(source: Path, target: Path) -> None:
        rename(source, target)
        found.append(("rename", Path(target).name))

    opened = os.open

    def named(path: object, *how: int) -> int:
        descriptor = opened(path, *how)  # pyright: ignore[reportArgumentType]
        if os.path.isfile(path):  # pyright: ignore[reportArgumentType]
            names[os.fstat(descriptor).st_ino] = Path(str(path)).read_text()
        return descriptor

    monkeypatch.setattr(os, "fsync", flushed)
    monkeypatch.setattr(os, "replace", renamed)
    monkeypatch.setattr(os, "open", named)
    return found


def test_what_is_written_is_flushed_before_it_is_named(events: list[tuple[str, str]], tmp_path: Path) -> None:
    expected = [("flush", "content"), ("rename", "a"), ("flush", "folder")]
    with atomic_file("new/one/a") as stream:
        assert events == [("flush", "folder")] * 2  # of the folders that "new" and "one" are in
        stream.write(b"content")
    with atomic_path("a") as path:
        path.write_text("content")
    assert events[2:] == 2 * expected
    events.clear()
    with staged(tmp_path / "all") as hidden:
        (hidden / "a").write_text("first")
        (hidden / "b").write_text("second")
    assert events == [
        ("flush", "first"), ("flush", "second"), ("flush", "folder"),  # of the folder that "all" is in
        ("rename", "a"), ("rename", "b"), ("flush", "folder"),
    ]  # fmt: skip


@pytest.mark.parametrize("write", [atomic_file, atomic_path])
def test_a_disk_that_refuses(write: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(_: int) -> None:
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(os, "fsync", refuse)
    path = tmp_path / "a"

    with (
        pytest.raises(WriteError, match=rf"^{path}: cannot be written \(Input/output error\)"),
        write(path) as target,
    ):
        target.write_text("x") if isinstance(target, Path) else target.write(b"x")
    assert not list(tmp_path.iterdir())
