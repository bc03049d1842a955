"""Wherever a process is killed, its output is the old one or the new one, whole; the next run leaves nothing else."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from cli_support import snapshot

# Replaces a.scoup; killed before the n-th step.
REPLACE = """
import os, shutil, signal, sys
from pathlib import Path
from scoup.base.atomic import atomic_file, atomic_path
writer, last, steps = sys.argv[1], int(sys.argv[2]), []
def counted(function):
    def step(*arguments, **more):
        steps.append(1)
        if len(steps) == last:
            os.kill(os.getpid(), signal.SIGKILL)
        return function(*arguments, **more)
    return step
for module, name in (
    (os, "replace"), (os, "fsync"), (Path, "mkdir"), (Path, "unlink"), (Path, "open"), (shutil, "rmtree")
):
    setattr(module, name, counted(getattr(module, name)))
if writer == "file":
    with atomic_file("a.scoup", overwrite=True) as stream:
        stream.write(b"new")
else:
    with atomic_path("a.scoup", overwrite=True) as path:
        path.write_bytes(b"new")
print(len(steps))
"""


def replaced(writer: str, last: int) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", REPLACE, writer, str(last)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    return subprocess.run(command, capture_output=True, text=True, env=environment)


@pytest.mark.parametrize("writer", ["file", "path"])
def test_killed_at_any_step(writer: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    whole = replaced(writer, 0)
    assert whole.returncode == 0, whole.stderr
    outcomes = set()
    for last in range(1, int(whole.stdout) + 1):
        Path("a.scoup").write_bytes(b"old")
        assert replaced(writer, last).returncode == -signal.SIGKILL
        outcomes.add(Path("a.scoup").read_bytes())
        assert replaced(writer, 0).returncode == 0
        assert snapshot(tmp_path) == {"a.scoup": b"new"}
    assert outcomes == {b"old", b"new"}
