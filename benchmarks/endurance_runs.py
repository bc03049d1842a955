"""Runs of verbs in processes of their own, some of them killed, and what they leave."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from benchmarks.endurance_child import BEGUN

CHILD = Path(__file__).with_name("endurance_child.py")
HANGS = 600
"""Seconds after which a run that nobody has killed is given up."""


@dataclass(frozen=True)
class Run:
    """One run of a verb."""

    KILLED: ClassVar[int] = -9

    code: int  # its exit code; ``KILLED`` where it was killed
    notes: tuple[str, ...]  # see ``benchmarks/endurance_child.py``
    seconds: float  # that it took
    said: str  # on standard error, its last line

    @property
    def begun(self) -> int:
        """Views that it began."""
        return self.notes.count(BEGUN)


def run(arguments: Sequence[str], work: Path, point: int = 0, after: float | None = None) -> Run:
    """Run a verb in a process of its own, in the folder ``work``.

    It kills itself at a point (0: at none), or is killed after some seconds (None: never).
    """
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "notes"
        command = [sys.executable, str(CHILD), str(log), str(work), str(point), *arguments]
        start = time.perf_counter()
        with subprocess.Popen(
            command,
            cwd=work,
            env=environment(),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        ) as process:
            try:
                _, said = process.communicate(timeout=HANGS if after is None else after)
            except subprocess.TimeoutExpired:
                process.kill()
                _, said = process.communicate()
                if after is None:
                    raise
        seconds = time.perf_counter() - start
        notes = tuple(log.read_text().splitlines()) if log.exists() else ()
    lines = said.strip().splitlines()
    return Run(process.returncode, notes, seconds, lines[-1] if lines else "")


def environment() -> dict[str, str]:
    """Return the environment of this process, with its paths of modules."""
    return {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}


def snapshot(folder: Path) -> dict[str, bytes]:
    """Return contents of every file below a folder; of a folder that is empty, nothing under its name and a slash."""
    found = {}
    for path in folder.rglob("*"):
        name = path.relative_to(folder).as_posix()
        if path.is_file():
            found[name] = path.read_bytes()
        elif not any(path.iterdir()):
            found[f"{name}/"] = b""
    return found
