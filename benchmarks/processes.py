"""What processes cost: wall and processor seconds, and memory."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from scoup.base import InputError

SCOUP = "from scoup.cli.app import entry; entry()"
"""A program: the command line."""
# The system's own figure for children begins with the memory of their parent.
_PEAK = """import atexit, sys
atexit.register(lambda: print(open("/proc/self/status").read().split("VmHWM:")[1].split()[0], file=sys.stderr))
"""


@dataclass(frozen=True)
class Finished:
    """A process that has ended well."""

    said: str
    wall_s: float
    cpu_s: float  # user and system, the start of Python included
    peak_bytes: int  # most resident memory


def run_python(program: str, *arguments: str, threads: int | None = None) -> Finished:
    """Run a program in a Python of its own, with so many threads."""
    environment = os.environ | ({} if threads is None else {"OMP_NUM_THREADS": str(threads)})
    environment.pop("PYTHONDONTWRITEBYTECODE", None)  # an installed program's byte code is written once
    command = [sys.executable, "-c", _PEAK + program, *arguments]
    started, before = time.perf_counter(), os.times()
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    wall, after = time.perf_counter() - started, os.times()
    if done.returncode:
        raise InputError(f"{' '.join(arguments)} failed: {done.stdout}{done.stderr}")
    used = after.children_user + after.children_system - before.children_user - before.children_system
    return Finished(done.stdout, wall, used, int(done.stderr.split()[-1]) * 1024)


def memory_of(process: int) -> dict[str, int]:
    """Return a process's own memory now (RssAnon) and its most resident memory (VmHWM), bytes; {} if unknown."""
    try:
        lines = Path(f"/proc/{process}/status").read_text().splitlines()
    except OSError:
        return {}
    fields = dict(line.split(":", 1) for line in lines if line.startswith(("RssAnon", "VmHWM")))
    return {name: int(value.split()[0]) * 1024 for name, value in fields.items()}
