"""The GPU benchmark's runner and rows: what fails, hangs, ends its process or finds no time, without waiting for it."""

from __future__ import annotations

import json
import math
import multiprocessing
import os
import subprocess
import sys
import time
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import pytest
import torch
from benchmarks.gpu import ROOT, runner
from benchmarks.gpu.__main__ import main, parse
from benchmarks.gpu.runner import Runner
from benchmarks.gpu.stage import LOST, NO_TIME, TINY, Row, Runs, Stage, Unavailable, add_ratios

from scoup.base.errors import InputError, OutputExistsError, UnknownNameError

pytestmark = pytest.mark.usefixtures("quick_python")


class Finished:
    """Stands for a process that has sent all it will send. One that hangs keeps its end of the pipe open."""

    pid = -1

    def __init__(self, exitcode: int | None, sender: Connection) -> None:
        self.exitcode, self._sender = exitcode, sender
        if exitcode is not None:
            sender.close()

    def join(self, timeout: float | None = None) -> None: ...
    def kill(self) -> None: ...


class Launches:
    """Stands for ``launch``: each start of a stage sends what ``script`` says, and ends or hangs."""

    def __init__(self, script: Any) -> None:
        self.script = script
        self.started: list[str] = []

    def __call__(
        self, name: str, sizes: Any, interpreted: bool, deadline: float
    ) -> tuple[Connection, Finished]:
        self.started.append(name)
        receiver, sender = multiprocessing.Pipe(duplex=False)
        exitcode = self.script(name, sender.send)
        return receiver, Finished(exitcode, sender)


KNOWN: list[Row] = [{"name": "good", "median_s": 1.0}, {"name": "other", "median_s": 2.0}]


def ailing(name: str, send: Any) -> int | None:
    """Stage "timing" ends with an error after two rows, and "build" hangs."""
    send({"rows": KNOWN[:1]})
    send({"rows": KNOWN})
    return {"timing": 7, "build": None}.get(name, 0)


def runner_of(results: dict[str, dict[str, Any]], launch: Any) -> Runner:
    return Runner(results, TINY, True, lambda: None, launch)


@pytest.fixture(autouse=True)
def _no_process_is_killed(monkeypatch: pytest.MonkeyPatch) -> None:
    kill = runner.kill
    monkeypatch.setattr(
        runner, "kill", lambda process: None if isinstance(process, Finished) else kill(process)
    )


def test_a_process_that_dies_or_hangs_costs_the_rest_of_its_stage(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runner, "RESERVE", 0.0)
    results: dict[str, dict[str, Any]] = {}
    for name in ("parity", "timing"):
        runner_of(results, Launches(ailing)).run(name)
    runner_of(results, Launches(ailing)).run("build", time.time() + 0.3)
    assert results == {
        "parity": {"rows": KNOWN},
        "timing": {"rows": KNOWN, "reason": "its process ended with 7"},
        "build": {"rows": KNOWN, "reason": f"stopped: {NO_TIME}"},
    }


def test_a_real_process_that_dies(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runner, "work", dies)
    results: dict[str, dict[str, Any]] = {}
    runner_of(results, runner.launch).run("timing")
    assert results["timing"] == {"rows": KNOWN, "reason": "its process ended with 3"}


def dies(sender: Connection, *_: object) -> None:
    sender.send({"rows": KNOWN})
    sender.close()
    os._exit(LOST)


def test_nothing_is_begun_when_the_time_is_up() -> None:
    results: dict[str, dict[str, Any]] = {}
    launches = Launches(ailing)
    runner_of(results, launches).run("build", end=0.0)
    assert launches.started == []
    assert results["build"] == {"rows": [], "reason": NO_TIME}


def stage(messages: list[dict[str, Any]], **changes: Any) -> Stage:
    return Stage(torch.device("cpu"), TINY, **{"deadline": math.inf, "send": messages.append, **changes})


def test_what_fails_is_a_row_with_a_reason() -> None:
    def missing() -> None:
        raise Unavailable("is not here")

    messages: list[dict[str, Any]] = []
    one = stage(messages)
    runs: Runs = {"good": lambda: None, "missing": missing}
    one.rows(runs, {"other": ["missing"], "good": ["good"]})
    good, *others = one.result["rows"]
    assert good["repeats"] == 1
    assert good["median_s"] >= 0
    assert "over" not in good
    assert others == [{"name": "missing", "reason": "is not here"}]
    assert messages[-1] == one.result


def test_without_time_nothing_runs_and_what_runs_stops() -> None:
    one = stage([], deadline=0.0)
    one.rows({"a": lambda: pytest.fail("ran")})
    assert one.once("b", lambda: pytest.fail("ran")) == {"name": "b", "reason": NO_TIME}
    assert one.result["rows"][0] == {"name": "a", "reason": NO_TIME}
    with pytest.raises(Unavailable, match="no time was left, at 3 of 9 of: vote"):
        one.progress("vote", 3, 9)
    stage([]).progress("vote", 3, 9)


def test_a_lost_device_ends_the_process_after_its_row_is_sent(monkeypatch: pytest.MonkeyPatch) -> None:
    def lost(*_: object) -> None:
        raise RuntimeError("an illegal memory access was encountered")

    def leave(code: int) -> None:
        raise SystemExit(code)

    monkeypatch.setattr(os, "_exit", leave)
    messages: list[dict[str, Any]] = []
    one = stage(messages)
    monkeypatch.setattr(type(one.clock), "settle", lost)
    with pytest.raises(SystemExit) as ended:
        one.row("breaks", lambda: lost() or {})
    assert ended.value.code == LOST
    assert messages[-1]["rows"] == [
        {"name": "breaks", "reason": "RuntimeError: an illegal memory access was encountered"}
    ]


def test_ratios_are_to_the_fastest_of_the_other() -> None:
    rows: list[Row] = [
        {"name": name, "median_s": value} for name, value in (("a", 6.0), ("b", 3.0), ("c", 2.0))
    ]
    add_ratios(rows, {"other": ["b", "c"], "unknown": ["d"]})
    assert rows[0]["over"] == {"other": 3.0}
    assert "over" not in rows[1]


def run_tiny(out: Path, launch: Any, *words: str) -> Path:
    return main(parse(["--quick", "--out", str(out), *words]), launch)


@pytest.fixture
def _without_a_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)


@pytest.mark.usefixtures("_without_a_gpu")
def test_what_is_known_is_written_whatever_it_is(tmp_path: Path) -> None:
    def odd(name: str, send: Any) -> int:
        send({"rows": [{"name": "a", "median_s": math.nan, "value": math.inf, "over": 3}]})
        return 0

    launches = Launches(odd)
    out = run_tiny(tmp_path / "gpu.json", launches, "--stages", "timing", "timing", "build")
    assert launches.started == ["timing", "build"]
    record = json.loads(out.read_text())
    assert record["finished"]
    assert record["stages"]["build"]["rows"] == [
        {"name": "a", "median_s": "NaN", "value": "Infinity", "over": 3}
    ]
    assert "could not be made" in out.with_suffix(".md").read_text()


@pytest.mark.usefixtures("_without_a_gpu")
def test_an_interrupted_run_leaves_what_it_knew(tmp_path: Path) -> None:
    def interrupted(name: str, send: Any) -> int:
        if name == "build":
            raise KeyboardInterrupt
        return ailing("parity", send) or 0

    with pytest.raises(KeyboardInterrupt):
        run_tiny(tmp_path / "gpu.json", Launches(interrupted), "--stages", "timing", "build")
    record = json.loads((tmp_path / "gpu.json").read_text())
    assert (record["finished"], record["reason"]) == (False, "interrupted")
    assert record["stages"]["timing"]["rows"] == KNOWN
    assert "**not finished** (interrupted)" in (tmp_path / "gpu.md").read_text()


@pytest.mark.usefixtures("_without_a_gpu")
def test_what_cannot_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match="stage"):
        main(parse(["--quick", "--stages", "render"]))
    with pytest.raises(InputError, match="finds no GPU"):
        main(parse([]))
    with pytest.raises(InputError, match="--out is needed"):
        main(parse(["--quick"]))
    with pytest.raises(InputError, match="ends with"):
        run_tiny(tmp_path / "gpu.txt", None)
    (tmp_path / "gpu.md").write_text("kept")
    with pytest.raises(OutputExistsError):
        run_tiny(tmp_path / "gpu.json", None)
    assert (tmp_path / "gpu.md").read_text() == "kept"


def test_nothing_must_be_installed() -> None:
    program = (
        "import sys; sys.meta_path = [f for f in sys.meta_path if 'Editable' not in type(f).__name__ and "
        "'scoup' not in type(f).__module__]; sys.modules['tyro'] = None; import benchmarks.gpu.__main__, scoup; "
        "print(scoup.__file__)"
    )
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(
        [sys.executable, "-c", program],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert Path(done.stdout.strip()) == ROOT / "src" / "scoup" / "__init__.py"
