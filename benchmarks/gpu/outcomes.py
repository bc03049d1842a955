"""A plugin of pytest that tells each outcome at once, and ends a process whose device hangs or is lost.

Given by ``-p benchmarks.gpu.outcomes``. The environment names a file for lines of JSON (``SCOUP_OUTCOMES``), one with
tests to leave out (``SCOUP_LEFT_OUT``), and the seconds that a test may take (``SCOUP_TEST_SECONDS``).
"""

from __future__ import annotations

import contextlib
import faulthandler
import json
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from benchmarks.gpu.parity import LOST


def tell(line: dict[str, Any]) -> None:
    with open(os.environ["SCOUP_OUTCOMES"], "a") as file:  # short lines: several processes may add to it
        file.write(json.dumps(line) + "\n")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    known = set(Path(os.environ["SCOUP_LEFT_OUT"]).read_text().splitlines())
    items[:] = [item for item in items if item.nodeid not in known]


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    tell({"test": item.nodeid, "outcome": "begun"})
    # Not a timer of Python's: what hangs may hold its lock.
    faulthandler.dump_traceback_later(float(os.environ["SCOUP_TEST_SECONDS"]), exit=True, file=2)
    try:
        return (yield)
    finally:
        faulthandler.cancel_dump_traceback_later()
        if device_is_lost():
            os._exit(LOST)  # all tests after it would fail


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    if os.environ.get("PYTEST_XDIST_WORKER"):
        return  # the process that started this one tells
    if report.when == "call" or report.outcome != "passed":
        line = {"test": report.nodeid, "outcome": report.outcome, "seconds": report.duration}
        if report.failed:
            line["text"] = report.longreprtext[-1500:]
        tell(line)


def device_is_lost() -> bool:
    torch = sys.modules.get("torch")
    if torch is None or not torch.cuda.is_initialized():
        return False
    with contextlib.suppress(RuntimeError):
        torch.cuda.synchronize()
        return False
    return True
