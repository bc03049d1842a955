"""The GPU benchmark's runner and rows: what fails, hangs, ends its process or finds no time, without waiting for it."""

from __future__ import annotations

import json
import math
import multiprocessing
import os
import subprocess
import sys
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import pytest
import torch
from benchmarks.gpu import ROOT, runner
from benchmarks.gpu.__main__ import main, parse
from benchmarks.gpu.runner import Runner, merge_rows
from benchmarks.gpu.stage import LOST, NO_TIME, TINY, Row, Stage, Unavailable, add_ratios

from scoup.base.errors import InputError, OutputExistsError, UnknownNameError

pytestmark = pytest.mark.usefixtures("quick_python")

Message = tuple[Any, ...]


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
        self.started: list[tuple[str, dict[str, str], list[str]]] = []

    def __call__(
        self, name: str, sizes: Any, interpreted: bool, deadline: float, left_out: dict[str, str],
        known: dict[str, Row],
    ) -> tuple[Connection, Finished]:  # fmt: skip
        self.started.append((name, dict(left_out), list(known)))
        receiver, sender = multiprocessing.Pipe(duplex=False)
        exitcode = self.script(name, left_out, sender.send)
        return receiver, Finished(exitcode, sender)


def ailing(name: str, left_out: dict[str, str], send: Any) -> int | None:
    """Of the stage "timing", "bad" ends the process and "slow" hangs, unless left out."""
    rows: list[Row] = []
    for what in ("good", "bad", "slow", "last"):
        send(("next", what, 0.0))  # it may be silent for no time at all: what is sent is there already
        send(("alive",))
        if what in left_out:
            rows.append({"name": what, "reason": left_out[what]})
        elif name == "timing" and what == "bad":
            return 7
        elif name == "timing" and what == "slow":
            return None
        else:
            rows.append({"name": what, "median_s": 1.0})
        send(("result", {"rows": rows}))
    send(("end", {"rows": rows}))
    return 0


def runner_of(results: dict[str, dict[str, Any]], launch: Any) -> Runner:
    return Runner(results, TINY, True, lambda: None, launch)


@pytest.fixture(autouse=True)
def _no_process_is_killed(monkeypatch: pytest.MonkeyPatch) -> None:
    kill = runner.kill
    monkeypatch.setattr(
        runner, "kill", lambda process: None if isinstance(process, Finished) else kill(process)
    )


def test_what_kills_a_process_or_hangs_costs_its_own_row() -> None:
    results: dict[str, dict[str, Any]] = {}
    launches = Launches(ailing)
    for name in ("parity", "timing", "build"):
        runner_of(results, launches).run(name)
    for name in ("parity", "build"):
        assert [row["median_s"] for row in results[name]["rows"]] == [1.0] * 4
    assert results["timing"] == {
        "rows": [
            {"name": "good", "median_s": 1.0},
            {"name": "bad", "reason": "its process ended with 7"},
            {"name": "slow", "reason": "it hung and was stopped"},
            {"name": "last", "median_s": 1.0},
        ]
    }
    died, hung = {"bad": "its process ended with 7"}, {"slow": "it hung and was stopped"}
    of_timing = [start[1:] for start in launches.started if start[0] == "timing"]
    assert of_timing == [({}, []), (died, ["good"]), (died | hung, ["good"])]


def test_a_real_process_that_dies(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runner, "work", dies)
    results: dict[str, dict[str, Any]] = {}
    runner_of(results, runner.launch).run("timing")
    assert results["timing"]["rows"] == [
        {"name": "good", "median_s": 1.0},
        {"name": "bad", "reason": "its process ended with 3"},
    ]
    assert "reason" not in results["timing"]


def dies(
    sender: Connection, name: str, sizes: Any, interpreted: bool, deadline: float, left_out: Any, known: Any
) -> None:
    rows: list[Row] = [{"name": "good", "median_s": 1.0}]
    sender.send(("result", {"rows": rows}))
    sender.send(("next", "bad", 600.0))
    if "bad" not in left_out:
        sender.close()
        os._exit(LOST)
    sender.send(("end", {"rows": [*rows, {"name": "bad", "reason": left_out["bad"]}]}))


def test_a_process_that_never_says_what_it_does_is_not_started_again() -> None:
    results: dict[str, dict[str, Any]] = {}
    launches = Launches(lambda name, left_out, send: 1)
    runner_of(results, launches).run("timing")
    assert len(launches.started) == 1
    assert results["timing"] == {"rows": [], "reason": "its process ended with 1"}


def test_nothing_is_begun_when_the_time_is_up() -> None:
    results: dict[str, dict[str, Any]] = {"timing": {"rows": [{"name": "known"}]}}
    launches = Launches(ailing)
    for name in ("timing", "build"):
        runner_of(results, launches).run(name, end=0.0)
    assert launches.started == []
    assert results["timing"] == {"rows": [{"name": "known"}], "reason": NO_TIME}
    assert results["build"] == {"rows": [], "reason": NO_TIME}


def test_what_an_earlier_process_knew_stays() -> None:
    known = {"a": {"name": "a", "median_s": 1.0}, "b": {"name": "b", "median_s": 2.0}}
    found = merge_rows(
        {"rows": [{"name": "a", "reason": "hung"}, {"name": "c", "median_s": 3.0}], "about": 1}, known
    )
    assert found == {
        "rows": [
            {"name": "a", "median_s": 1.0},
            {"name": "c", "median_s": 3.0},
            {"name": "b", "median_s": 2.0},
        ],
        "about": 1,
    }


def stage(messages: list[Message], **changes: Any) -> Stage:
    return Stage(torch.device("cpu"), TINY, **{"deadline": math.inf, "send": messages.append, **changes})


def test_what_fails_is_a_row_with_a_reason() -> None:
    def missing() -> None:
        raise Unavailable("is not here")

    messages: list[Message] = []
    one = stage(messages, left_out={"left out": "it hung"})
    runs = {"good": lambda: None, "missing": missing, "left out": lambda: pytest.fail("ran")}
    one.rows(runs, {"other": ["missing"], "good": ["good"]})
    good, *others = one.result["rows"]
    assert good["repeats"] == 1
    assert good["median_s"] >= 0
    assert "over" not in good
    assert others == [{"name": "missing", "reason": "is not here"}, {"name": "left out", "reason": "it hung"}]
    assert messages[-1] == ("result", one.result)
    assert [message[1] for message in messages if message[0] == "next"][:3] == ["good", "missing", "left out"]


def test_rows_that_are_known_are_not_made_again() -> None:
    one = stage([], known={"a": {"name": "a", "median_s": 1.0}})
    assert one.once("a", lambda: pytest.fail("ran")) == {"name": "a", "median_s": 1.0}
    assert one.once("b", lambda: None)["repeats"] == 1


def test_without_time_nothing_runs_and_what_runs_stops() -> None:
    one = stage([], deadline=0.0)
    one.rows({"a": lambda: pytest.fail("ran")})
    assert one.once("b", lambda: pytest.fail("ran")) == {"name": "b", "reason": NO_TIME}
    assert one.result["rows"][0] == {"name": "a", "reason": NO_TIME}
    with pytest.raises(Unavailable, match="no time was left, at 3 of 9 of: vote"):
        one.progress("vote", 3, 9)
    messages: list[Message] = []
    stage(messages).progress("vote", 3, 9)
    assert messages == [("alive",)]


def test_a_lost_device_ends_the_process_after_its_row_is_sent(monkeypatch: pytest.MonkeyPatch) -> None:
    def lost(*_: object) -> None:
        raise RuntimeError("an illegal memory access was encountered")

    def leave(code: int) -> None:
        raise SystemExit(code)

    monkeypatch.setattr(os, "_exit", leave)
    messages: list[Message] = []
    one = stage(messages)
    monkeypatch.setattr(type(one.clock), "settle", lost)
    with pytest.raises(SystemExit) as ended:
        one.row("breaks", lambda: lost() or {})
    assert ended.value.code == LOST
    assert messages[-1][1]["rows"] == [
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
    def odd(name: str, left_out: dict[str, str], send: Any) -> int:
        send(("end", {"rows": [{"name": "a", "median_s": math.nan, "value": math.inf, "over": 3}]}))
        return 0

    launches = Launches(odd)
    out = run_tiny(tmp_path / "gpu.json", launches, "--stages", "timing", "timing", "build")
    assert [start[0] for start in launches.started] == ["timing", "build"]
    record = json.loads(out.read_text())
    assert record["finished"]
    assert record["stages"]["build"]["rows"] == [
        {"name": "a", "median_s": "NaN", "value": "Infinity", "over": 3}
    ]
    assert "could not be made" in out.with_suffix(".md").read_text()


@pytest.mark.usefixtures("_without_a_gpu")
def test_an_interrupted_run_leaves_what_it_knew(tmp_path: Path) -> None:
    def interrupted(name: str, left_out: dict[str, str], send: Any) -> int:
        if name == "build":
            raise KeyboardInterrupt
        return ailing("parity", left_out, send) or 0

    with pytest.raises(KeyboardInterrupt):
        run_tiny(tmp_path / "gpu.json", Launches(interrupted), "--stages", "timing", "build")
    record = json.loads((tmp_path / "gpu.json").read_text())
    assert (record["finished"], record["reason"]) == (False, "interrupted")
    assert len(record["stages"]["timing"]["rows"]) == 4
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
