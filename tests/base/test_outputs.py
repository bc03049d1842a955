"""Wherever a process is killed, its output is the old one or the new one, whole; the next run leaves nothing else.

So it is after a power cut: files are on the disk before they get their names, and the names after that.
"""

from __future__ import annotations

import os
import shutil
import signal
import stat
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from children import forked
from cli_support import snapshot
from scoup.base.errors import WriteError
from scoup.base.outputs import atomic_file, atomic_path, staged

STEPS = (
    (os, "replace"), (os, "fsync"), (Path, "mkdir"), (Path, "unlink"), (Path, "open"), (shutil, "rmtree"),
)  # fmt: skip


def replace_output(writer: str, last: int) -> int:
    """Replace a.scoup in this process, which is killed before the step of a number; how many steps there are."""
    steps = []

    def counted(function: Callable[..., Any]) -> Callable[..., Any]:
        def step(*arguments: Any, **more: Any) -> Any:
            steps.append(1)
            if len(steps) == last:
                os.kill(os.getpid(), signal.SIGKILL)
            return function(*arguments, **more)

        return step

    for module, name in STEPS:
        setattr(module, name, counted(getattr(module, name)))
    if writer == "file":
        with atomic_file("a.scoup", overwrite=True) as stream:
            stream.write(b"new")
    else:
        with atomic_path("a.scoup", overwrite=True) as path:
            path.write_bytes(b"new")
    return len(steps)


def replaced(writer: str, last: int) -> int:
    """``replace_output`` in a process of its own: its number of steps, or the signal that has ended it, negative."""
    return forked(lambda: replace_output(writer, last))


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
@pytest.mark.parametrize("writer", ["file", "path"])
def test_killed_at_any_step(writer: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    count = replaced(writer, 0)
    assert 3 < count < 255
    outcomes = set()
    for last in range(1, count + 1):
        Path("a.scoup").write_bytes(b"old")
        assert replaced(writer, last) == -signal.SIGKILL
        outcomes.add(Path("a.scoup").read_bytes())
        assert replaced(writer, 0) == count
        assert snapshot(tmp_path) == {"a.scoup": b"new"}
    assert outcomes == {b"old", b"new"}


def test_what_is_written_is_flushed_before_it_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    rename, events = os.replace, []

    def flush(descriptor: int) -> None:
        found = os.fstat(descriptor)
        events.append("folder" if stat.S_ISDIR(found.st_mode) else f"{found.st_size} bytes")

    def renamed(source: Path, target: Path) -> None:
        events.append(f"rename {Path(target).name}")
        rename(source, target)

    monkeypatch.setattr(os, "fsync", flush)
    monkeypatch.setattr(os, "replace", renamed)
    with atomic_file("new/a") as stream:
        assert events == ["folder"]  # that "new" is in
        stream.write(b"12")
    with atomic_path("a") as path:
        path.write_text("12")
    assert events[1:] == 2 * ["2 bytes", "rename a", "folder"]
    events.clear()
    with staged(tmp_path / "new", ["a", "b"], overwrite=True) as hidden:
        (hidden / "a").write_text("1")
        (hidden / "b").write_text("12")
    assert events == ["1 bytes", "2 bytes", "rename a", "rename b", "folder"]


@pytest.mark.parametrize("write", [atomic_file, atomic_path])
def test_a_disk_that_refuses(write: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(_: int) -> None:
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(os, "fsync", refuse)
    said = rf"^{tmp_path}/a: cannot be written \(Input/output error\)"
    with pytest.raises(WriteError, match=said), write(tmp_path / "a") as target:
        target.write_text("x") if isinstance(target, Path) else target.write(b"x")
    assert not list(tmp_path.iterdir())
