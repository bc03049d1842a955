"""Seconds until each verb prints something on a terminal."""

from __future__ import annotations

import os
import select
import shlex
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.processes import SCOUP, run_python
from benchmarks.study import Record, Study
from scoup.base import InputError
from scoup_lab.bench import markdown

VERBS = (
    "demo --out other", "views demo/scene/point_cloud.ply", "extract demo/scene", "words --words demo/scene/words.txt",
    "build demo/scene --out a.scoup", "transfer demo/demo.scoup demo/scene/point_cloud.ply",
    "query demo/demo.scoup teapot", "select demo/demo.scoup teapot --out a.ply", "label demo/demo.scoup teapot",
    "catalog demo/demo.scoup", "render demo/demo.scoup", "view demo/demo.scoup", "mcp demo/demo.scoup",
    "batch demo", "archive archive --add demo/demo.scoup", "compare demo/demo.scoup demo/demo.scoup",
    "info demo/demo.scoup", "eval lerf-ovs demo",
)  # fmt: skip
LONGEST = 120.0  # seconds


@dataclass(frozen=True, kw_only=True)
class FirstWords(Study):
    """Time the first output of every verb on a terminal, on a small scene of the demo."""

    n_gaussians: int = 20_000
    """Of the scene."""
    repeats: int = 3
    """Of which the median counts."""
    verbs: tuple[str, ...] = VERBS
    """Commands without `scoup`."""

    def measure(self, known: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
        with tempfile.TemporaryDirectory() as name:
            size = (
                "--n-gaussians",
                str(self.n_gaussians),
                "--views",
                "8",
                "--width",
                "160",
                "--height",
                "120",
            )
            run_python(SCOUP, "demo", *size, "--out", f"{name}/demo")
            for line in self.verbs:
                if (verb := line.split()[0]) not in known:
                    yield verb, sorted(first_word(shlex.split(line), Path(name)) for _ in range(self.repeats))

    def line(self, figures: Any) -> str:
        return f"{figures[len(figures) // 2]:.2f} s"

    @staticmethod
    def table(record: Record) -> str:
        """Return the medians of the fastest and of the slowest verb."""
        medians = {verb: times[len(times) // 2] for verb, times in record["rows"].items()}
        ends = min(medians, key=medians.__getitem__), max(medians, key=medians.__getitem__)
        return markdown(["first word", "s"], [[f"`scoup {verb}`", f"{medians[verb]:.2f}"] for verb in ends])


def first_word(arguments: list[str], folder: Path) -> float:
    """Return the seconds from the start of ``scoup ARGUMENTS`` to its first output on a terminal, and end it."""
    import pty  # not on Windows

    ours, theirs = pty.openpty()
    started = time.perf_counter()
    process = subprocess.Popen(
        [sys.executable, "-c", SCOUP, *arguments],
        cwd=folder, stdin=theirs, stdout=theirs, stderr=theirs, start_new_session=True,
    )  # fmt: skip
    try:
        if not select.select([ours], [], [], LONGEST)[0]:
            raise InputError(f"scoup {shlex.join(arguments)} printed nothing in {LONGEST:.0f} s")
        return time.perf_counter() - started
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        os.close(ours)
        os.close(theirs)
