"""Nothing that a test starts outlives its block, and no test waits for ever."""

from __future__ import annotations

import os
import re
import signal
import sys
import time
from concurrent.futures import Future
from contextlib import suppress
from pathlib import Path

import pytest

from children import child, finished, forked, workers

TESTS = Path(__file__).parent
pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="processes of Unix")
SLEEPS = "import subprocess, sys; subprocess.Popen(['sleep', '600']); print('started', flush=True); sys.stdin.read()"


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="this system does not list its processes")
def test_a_child_and_what_it_started_are_killed_when_the_block_fails() -> None:
    grandchild = "0"
    with suppress(ZeroDivisionError), child([sys.executable, "-c", SLEEPS], stdin=-1) as process:
        assert process.stdout.readline() == "started\n"
        (grandchild,) = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
        raise ZeroDivisionError
    assert process.returncode == -9
    # The system may take a moment after a kill; a zombie was killed. The limit of the test ends the wait.
    place = Path(f"/proc/{grandchild}/stat")
    while place.exists() and not place.read_text().rpartition(") ")[2].startswith("Z"):
        time.sleep(0.01)


def test_a_child_can_be_interrupted_even_if_the_tests_run_in_the_background() -> None:
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        program = "import signal; print(signal.getsignal(signal.SIGINT) is signal.default_int_handler)"
        assert finished([sys.executable, "-c", program]).stdout == "True\n"
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)


def test_workers_and_forks_are_killed_when_the_block_fails() -> None:
    waiting: Future[None] = Future()
    with suppress(ZeroDivisionError), workers(1) as pool:
        waiting = pool.submit(time.sleep, 600)
        while not waiting.running():
            time.sleep(0.01)
        raise ZeroDivisionError
    assert waiting.done()
    assert forked(lambda: os.kill(os.getpid(), 9) or 0) == -9
    assert forked(lambda: 3) == 3


def test_tests_start_processes_through_one_module() -> None:
    own = re.compile(
        r"subprocess\.(run|Popen|call|check_\w+)\(|\b(Popen|Child)\(|os\.(fork|system|popen)\(|ProcessPoolExecutor\("
    )
    found = {path.name for path in TESTS.rglob("*.py") if own.search(path.read_text(encoding="utf-8"))}
    assert found == {"children.py", "preloaded.py", Path(__file__).name}


def test_no_test_runs_longer_than_two_minutes(pytestconfig: pytest.Config) -> None:
    assert pytestconfig.pluginmanager.hasplugin("timeout")
    assert pytestconfig.getini("timeout") == "120"
