"""The parity suite, run before anything is timed: figures of a rasteriser that draws something else mean nothing."""

from __future__ import annotations

import contextlib
import importlib.util
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
LOST = 3  # exit code: the device is lost
SUITE = (
    "tests/raster/test_gpu.py",
    "tests/coding/test_gpu_coder.py",
    "tests/test_scatter_kernel.py",
    "tests/uplift/test_vote_gpu.py",
)
NEEDED = ("pytest", "hypothesis")
MOST_PROCESSES = 6
STARTS = 20  # each broken or hanging test costs one, where tests do not run in several processes
TEST_SECONDS = 300.0  # a test that takes longer hangs
TOLD_EVERY = 10.0  # seconds


def run_parity(
    timeout_s: float | None = None,
    only: str = "",
    known: Callable[[dict[str, Any]], None] = lambda found: None,
) -> dict[str, Any]:
    """Run it by pytest in processes of its own and record what came of it.

    A test that breaks the device or hangs fails; the tests after it run in another process.

    Args:
        timeout_s: after which it is stopped; what it had found by then is kept.
        only: an expression of pytest's ``-k``.
        known: given the record now and then, while the suite runs.
    """
    missing = [name for name in NEEDED if importlib.util.find_spec(name) is None]
    if missing:
        return {
            "passed": False,
            "reason": f"not run: {' and '.join(missing)} must be installed for it; the stage 'agreement' needs neither",
        }
    started = time.time()
    latest = float("inf") if timeout_s is None else started + timeout_s
    with tempfile.TemporaryDirectory() as folder:
        suite = _Suite(Path(folder), only)
        code: int | None = None
        for _ in range(STARTS):
            code = suite.run(latest, lambda: known(suite.record(None, time.time() - started)))
            if code is None or not suite.leave_out():
                break
        record = suite.record(code, time.time() - started)
    if code is None:
        record["reason"] = f"stopped after {timeout_s:.0f} s"
    elif not record["passed"]:
        failed = len(record["failed"])
        record["reason"] = f"{failed} failed" if failed else f"pytest ended with {code}"
    return record


class _Suite:
    """The suite's files in a folder, and what its tests have told so far."""

    def __init__(self, folder: Path, only: str) -> None:
        self._outcomes, self._left_out = folder / "outcomes", folder / "left-out"
        self._log = folder / "log"
        self._code: int | None = None
        for file in (self._outcomes, self._left_out, self._log):
            file.touch()
        self._command = [sys.executable, "-m", "pytest", *SUITE, "-p", "no:cacheprovider", "--tb=short"]
        self._command += ["-p", "benchmarks.gpu.outcomes"]
        self._command += ["-k", only] if only else []
        processes = min(MOST_PROCESSES, (os.cpu_count() or 1) // 2)
        if processes > 1 and importlib.util.find_spec("xdist") is not None:
            self._command += ["-n", str(processes), "--max-worker-restart", str(STARTS)]
        # The suite interprets kernels in processes of its own, and on a GPU it must not. Nor is it part of a run of
        # tests that this one may be called from.
        self._environment = {
            name: value
            for name, value in os.environ.items()
            if name != "TRITON_INTERPRET" and not name.startswith("PYTEST_")
        }
        paths = [str(Path(__file__).resolve().parents[2]), *filter(None, [os.environ.get("PYTHONPATH")])]
        self._environment |= {
            "PYTHONPATH": os.pathsep.join(paths),
            "SCOUP_OUTCOMES": str(self._outcomes),
            "SCOUP_LEFT_OUT": str(self._left_out),
            "SCOUP_TEST_SECONDS": str(TEST_SECONDS),
            "OMP_NUM_THREADS": os.environ.get("OMP_NUM_THREADS", "2"),
        }

    def run(self, latest: float, told: Callable[[], None]) -> int | None:
        """pytest's exit code; None if it was stopped, for the time was up."""
        with self._log.open("ab") as log:
            process = subprocess.Popen(
                self._command, cwd=ROOT, env=self._environment, stdout=log, stderr=log, start_new_session=True
            )
        try:
            while True:
                wait = min(TOLD_EVERY, latest - time.time())
                if wait <= 0:
                    return None
                try:
                    self._code = process.wait(wait)
                    return self._code
                except subprocess.TimeoutExpired:
                    told()
        finally:
            with contextlib.suppress(OSError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()

    def leave_out(self) -> bool:
        """Whether tests are left because one has ended the process of all. What has been told of is not run again."""
        outcomes = self.outcomes()
        begun = [test for test, line in outcomes.items() if line["outcome"] == "begun"]
        with self._outcomes.open("a") as file:
            for test in begun:
                line = {"test": test, "outcome": "failed", "text": "it ended its process, or hung"}
                file.write(json.dumps(line) + "\n")
        self._left_out.write_text("".join(f"{test}\n" for test in outcomes))
        return bool(begun) or self._code == LOST

    def outcomes(self) -> dict[str, dict[str, Any]]:
        """By test, the last and worst that it told."""
        found: dict[str, dict[str, Any]] = {}
        for line in self._outcomes.read_text().splitlines():
            with contextlib.suppress(ValueError):  # half a line, where a process was ended
                told = json.loads(line)
                if found.get(told["test"], {}).get("outcome") != "failed":
                    found[told["test"]] = told
        return found

    def record(self, code: int | None, seconds: float) -> dict[str, Any]:
        outcomes = self.outcomes()
        counts: dict[str, int] = {}
        for line in outcomes.values():
            counts[line["outcome"]] = counts.get(line["outcome"], 0) + 1
        failed = [line for line in outcomes.values() if line["outcome"] == "failed"]
        record: dict[str, Any] = {
            "passed": code == 0 and not failed and counts.get("passed", 0) > 0,
            "exit_code": code,
            "seconds": seconds,
            "counts": counts,
            "failed": [line["test"] for line in failed][:100],
            "texts": {line["test"]: line.get("text", "") for line in failed[:20]},
        }
        if not record["passed"]:
            record["reason"] = "still running"
            record["output"] = self._log.read_text(errors="replace")[-6000:]
        return record
