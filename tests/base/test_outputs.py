"""Wherever a process is killed, its output is the old one or the new one, whole; the next run leaves nothing else."""

from __future__ import annotations

import os
import shutil
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from children import forked
from cli_support import snapshot
from scoup.base.outputs import atomic_file, atomic_path

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
