"""Every answer of the Triton backends against the reference: the tests of the kernels, a row each."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from benchmarks.gpu import ROOT
from benchmarks.gpu.stage import NO_TIME, Row, Stage, Unavailable

SUITE = (
    *("tests/raster/test_gpu.py", "tests/coding/test_gpu_coder.py", "tests/uplift/test_vote_gpu.py"),
    *("tests/raster/test_triton.py", "tests/coding/test_triton_coder.py", "tests/uplift/test_vote_triton.py"),
    "tests/bench/test_scatter.py",
)


def parity(stage: Stage, suite: tuple[str, ...] = SUITE, root: Path = ROOT) -> None:
    """Run the tests of the kernels: on the GPU where there is one; interpreted and compiled in any case."""
    import pytest

    os.chdir(root)
    words = [*suite, "-q", "--tb=short", "-p", "no:cacheprovider", "-p", "no:xdist"]
    tests = Tests(stage)
    pytest.main([*words, *(["-k", stage.sizes.tests] if stage.sizes.tests else [])], [tests])
    if not tests.rows:
        raise Unavailable(f"no test ran; {tests.problem}")


class Tests:
    """A plugin of pytest that makes rows of a stage: "outcome" of each test, and "reason" where it failed."""

    def __init__(self, stage: Stage) -> None:
        self.stage, self.rows = stage, stage.result["rows"]
        self.row: Row = {}
        self.problem = ""

    def pytest_collectreport(self, report: Any) -> None:
        if report.failed:
            self.problem = failure_line(report.longreprtext)

    def pytest_sessionstart(self, session: Any) -> None:
        self.session = session

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        self.row = {"name": nodeid, "outcome": "passed"}

    def pytest_runtest_logreport(self, report: Any) -> None:
        if report.outcome != "passed":
            self.row["outcome"] = report.outcome
        if report.failed:
            self.row["reason"] = failure_line(report.longreprtext)

    def pytest_runtest_logfinish(self) -> None:
        if self.row["outcome"] != "skipped":  # there are many where there is no GPU
            self.rows.append(self.row)
            self.stage.save()
        self.stage.recover()
        if self.stage.time_is_up():
            self.session.shouldstop = self.stage.result["reason"] = NO_TIME


def failure_line(text: str) -> str:
    """Return the line of a traceback that says what is wrong."""
    lines = [line.strip() for line in text.splitlines() if line.strip()] or [""]
    return next((line for line in lines if line.startswith("E ")), lines[-1]).replace("`", "'")[:300]
