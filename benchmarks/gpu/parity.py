"""The parity suite, run before anything is timed: figures of a rasteriser that draws something else mean nothing."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
SUITE = ("tests/raster/test_gpu.py", "tests/coding/test_gpu_coder.py", "tests/test_scatter_kernel.py")


def run_parity(timeout_s: float | None = None, only: str = "") -> dict[str, Any]:
    """Run it by pytest in a process of its own and record what came of it.

    Args:
        timeout_s: after which it is stopped; what it had found by then is kept.
        only: an expression of pytest's ``-k``.
    """
    command = [sys.executable, "-m", "pytest", *SUITE, "-p", "no:cacheprovider", "-rfEs", "--tb=short"]
    command += ["-k", only] if only else []
    # The suite interprets kernels in processes of its own, and on a GPU it must not.
    environment = {name: value for name, value in os.environ.items() if name != "TRITON_INTERPRET"}
    started = time.perf_counter()
    try:
        done = subprocess.run(
            command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=timeout_s, check=False
        )
        output, code = done.stdout + done.stderr, done.returncode
    except subprocess.TimeoutExpired as late:
        output, code = _text(late.stdout) + _text(late.stderr), None
    except OSError as error:
        return {"passed": False, "reason": f"pytest cannot be started: {error}"}
    record: dict[str, Any] = {
        "passed": code == 0,
        "exit_code": code,
        "seconds": time.perf_counter() - started,
        "counts": counts_of(output),
    }
    if code is None:
        record["reason"] = f"stopped after {timeout_s:.0f} s"
    elif code:
        record["reason"] = f"pytest ended with {code}"
    record["failed"] = re.findall(r"^(?:FAILED|ERROR) (\S+)", output, re.MULTILINE)[:100]
    if not record["passed"]:
        record["output"] = output[-6000:]
    return record


def counts_of(output: str) -> dict[str, int]:
    """passed, failed, skipped ... of pytest's last line; empty where it did not come to one."""
    lines = [line for line in output.splitlines() if re.search(r"\d+ (passed|failed|skipped|error)", line)]
    if not lines:
        return {}
    return {name: int(number) for number, name in re.findall(r"(\d+) ([a-z]+)", lines[-1])}


def _text(output: str | bytes | None) -> str:
    return output.decode(errors="replace") if isinstance(output, bytes) else output or ""
