"""The whole run: parity, then the stages in processes of their own, and the files written as results come in."""

from __future__ import annotations

import contextlib
import math
import multiprocessing
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from pathlib import Path
from typing import Any

from benchmarks.gpu.machine import describe_machine
from benchmarks.gpu.parity import run_parity
from benchmarks.gpu.peer_building import PeerBuilding
from benchmarks.gpu.report import report
from benchmarks.gpu.sizes import Sizes
from benchmarks.gpu.worker import STAGES, UNTIMED, work_through
from scoup.bench import write_json
from scoup.io import write_text

RESERVE = 15.0  # seconds before the end after which nothing is begun
QUIET = {"full": 300.0, "quick": 120.0, "smoke": 600.0}  # seconds without a word after which a process hangs
STARTS = 6  # processes that one stage may use up
BESIDE_THE_PEER = ("rendering", "sums", "large", "scaling")
UNFINISHED = "not finished when this was written"
SHARE_OF_PARITY = 0.5  # most of the time that is left
SHARE_OF_PEER = (
    0.65  # of all the time: when gsplat must be compiled; what is measured beside it needs the rest
)
LONGEST_PEER = 1200.0  # seconds, where no budget is given


def conduct(
    out: Path,
    sizes: Sizes,
    stages: Sequence[str],
    mode: str,
    interpreted: bool = False,
    parity: bool = True,
    only: str = "",
    budget_s: float | None = None,
    peer: bool = True,
) -> dict[str, Any]:
    """Run everything and write ``out`` (JSON) and the same with .md, anew after each thing that is known.

    Args:
        out: the JSON file; replaced.
        sizes: of everything.
        stages: names, in order.
        mode: "full", "quick" or "smoke".
        interpreted: with interpreted kernels.
        parity: run the parity suite first.
        only: of the suite, an expression of pytest's ``-k``.
        budget_s: seconds for all; what does not fit is left out and says so.
        peer: compile gsplat beside the parity suite, and compare with it.

    Returns:
        The record, as written.
    """
    started = time.time()
    deadline = float("inf") if budget_s is None else started + budget_s
    record: dict[str, Any] = {
        "what": "benchmarks.gpu",
        "mode": mode,
        "started": time.strftime("%Y-%m-%d %H:%M UTC", time.gmtime(started)),
        "machine": describe_machine(),
        "settings": {**asdict(sizes), "budget_s": budget_s, "interpreted": interpreted},
        "parity": {"reason": "not run"},
        "peer": {"reason": "" if interpreted else "not asked for"},
        "stages": {},
        "finished": False,
    }

    def write() -> None:
        record["seconds"] = time.time() - started
        write_json(out, for_json(record), overwrite=True)
        try:
            page = report(record)
        except Exception as error:  # figures of hours are not to be lost for a table
            page = f"This page could not be made ({error!r}); {out.name} holds everything.\n"
        write_text(out.with_suffix(".md"), page, overwrite=True)

    write()
    timed = [name for name in stages if name not in UNTIMED]
    wanted = not timed or any(name in BESIDE_THE_PEER for name in timed)
    building = PeerBuilding() if peer and wanted and not interpreted else None
    conductor = Conductor(record, sizes, interpreted, deadline, QUIET[mode], write)
    try:
        if building is not None:
            building.start()
            record["peer"] = {"reason": "not compiled when this was written"}
        conductor.run([name for name in stages if name in UNTIMED])
        if parity:
            say("parity suite")
            left = None
            if budget_s is not None:
                share = SHARE_OF_PARITY if timed else 1.0
                left = max(1.0, share * (deadline - RESERVE - time.time()))

            def parity_known(found: dict[str, Any]) -> None:
                record["parity"] = found
                write()

            parity_known(run_parity(left, only, parity_known))
        if building is not None:
            say("waiting until gsplat is compiled")
            share = SHARE_OF_PEER if timed else 1.0
            latest = started + (LONGEST_PEER if budget_s is None else share * (budget_s - RESERVE))
            record["peer"] = building.finish(latest)
            write()
        conductor.no_peer = record["peer"]["reason"]
        conductor.run(timed)
        record["finished"] = True
    except KeyboardInterrupt:
        record["reason"] = "interrupted"
        raise
    finally:
        if building is not None:
            building.stop()
        write()
    return record


@dataclass(eq=False)
class Heard:
    """What came from a process.

    Attributes:
        running: the stage it was in when it fell silent or ended; None between stages.
        ended: stages it has ended.
        doing: what it was about to do in ``running``.
        silent: it said nothing for too long, or the time was up.
    """

    running: str | None = None
    ended: list[str] = field(default_factory=list)
    doing: str = ""
    silent: bool = False


@dataclass(eq=False)
class Conductor:
    """Has stages run in processes.

    What ends a process, breaks its device or hangs costs its own row: the stage is run again in another process that
    leaves it out. What was known before stays where the other process comes to know less.

    Attributes:
        record: "stages" takes the results.
        sizes, interpreted: of everything.
        deadline: seconds since the epoch.
        quiet_s: how long a process may say nothing.
        write: keeps the record.
        no_peer: why gsplat is not used, "" where it may be.
    """

    record: dict[str, Any]
    sizes: Sizes
    interpreted: bool
    deadline: float
    quiet_s: float
    write: Callable[[], None]
    no_peer: str = ""

    def run(self, stages: Sequence[str]) -> None:
        """Run stages in order."""
        results: dict[str, dict[str, Any]] = self.record["stages"]
        left, starts = list(stages), dict.fromkeys(stages, 0)
        left_out: dict[str, dict[str, str]] = {name: {} for name in stages}
        earlier: dict[str, dict[str, Any]] = {}
        while left:
            if time.time() > self.deadline - RESERVE:
                for name in left:
                    results.setdefault(name, {"rows": [], "reason": "no time was left"})
                self.write()
                return
            heard, why = self.start(left, left_out, earlier)
            left = [name for name in left if name not in heard.ended]
            stage = heard.running
            if stage is None and not heard.ended:  # it did not even begin
                stage = left[0]
                results.setdefault(stage, {"rows": []})
            if stage is None:
                continue
            results[stage]["reason"] = why
            starts[stage] += 1
            known = heard.doing and heard.doing not in left_out[stage]
            if known and starts[stage] < STARTS and time.time() < self.deadline - RESERVE:
                say(f"{stage}: {why}; once more, without: {heard.doing}")
                left_out[stage][heard.doing] = reason_of(results[stage], heard.doing) or why
                earlier[stage] = results[stage]
            else:
                left.remove(stage)
            self.write()

    def start(
        self, left: list[str], left_out: dict[str, dict[str, str]], earlier: dict[str, dict[str, Any]]
    ) -> tuple[Heard, str]:
        """One process: what was heard of it, and why it ended."""
        ceilings = self.record["stages"].get("ceilings", {}).get("ceilings", {})
        context = multiprocessing.get_context("spawn")
        receiver, sender = context.Pipe(duplex=False)
        arguments = (left, self.sizes, self.interpreted, self.deadline - RESERVE, ceilings, sender)
        process = context.Process(target=work_through, args=(*arguments, left_out, self.no_peer), daemon=True)
        process.start()
        sender.close()
        heard = Heard()
        try:
            self.listen(receiver, heard, earlier)
        finally:
            why = stop(process, heard.silent, time.time() >= self.deadline)
        return heard, why

    def listen(self, receiver: Connection, heard: Heard, earlier: dict[str, dict[str, Any]]) -> None:
        """Take in what a process sends until it ends, says nothing for too long, or the time is up."""
        results: dict[str, dict[str, Any]] = self.record["stages"]
        while True:
            if not receiver.poll(max(0.0, min(self.quiet_s, self.deadline - time.time()))):
                heard.silent = True
                return
            try:
                message = receiver.recv()
            except (EOFError, OSError):
                return
            kind, name = message[:2]
            if kind == "doing":
                heard.doing = message[2] or heard.doing
                continue
            if kind == "begin":
                say(f"{name}: {STAGES[name][1]}")
                heard.running, heard.doing = name, ""
                results[name] = merged({"rows": [], "reason": UNFINISHED}, earlier.get(name))
                continue
            results[name] = merged(message[2], earlier.get(name))
            if kind == "end":
                heard.running, heard.doing = None, ""
                heard.ended.append(name)
            else:
                results[name].setdefault("reason", UNFINISHED)
            self.write()


def for_json(value: Any) -> Any:
    """The same with numbers that are not finite, which JSON does not know, as text."""
    if isinstance(value, dict):
        return {key: for_json(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [for_json(item) for item in value]
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value


def merged(result: dict[str, Any], earlier: dict[str, Any] | None) -> dict[str, Any]:
    """A result with what an earlier process knew and this one does not (yet)."""
    if earlier is None:
        return result
    measured = {key_of(row) for row in result["rows"] if "median_s" in row or "agrees" in row}
    old = {key_of(row): row for row in earlier["rows"] if "median_s" in row or "agrees" in row}
    rows = [row if key_of(row) in measured else old.get(key_of(row), row) for row in result["rows"]]
    there = {key_of(row) for row in rows}
    rows += [row for key, row in old.items() if key not in there]
    kept = {name: value for name, value in earlier.items() if name not in ("rows", "reason", "traceback")}
    return {**kept, **result, "rows": rows}


def key_of(row: dict[str, Any]) -> tuple[Any, ...]:
    return tuple(row.get(name) for name in ("name", "for", "grows", "amount"))


def reason_of(result: dict[str, Any], name: str) -> str | None:
    """Why the row of that name was not measured, as the row tells."""
    return next(
        (row["reason"] for row in result["rows"] if row.get("name") == name and "reason" in row), None
    )


def stop(process: SpawnProcess, silent: bool, late: bool) -> str:
    """See that the process has ended; why it did."""
    process.join(0.5 if silent else 5.0)
    if not process.is_alive():
        return f"its process ended with {process.exitcode}"
    process.kill()  # one that waits for a device listens to nothing less
    process.join(10.0)
    return "stopped: no time was left" if late else "it hung and was stopped"


def say(line: str) -> None:
    with contextlib.suppress(OSError):
        print(time.strftime("%H:%M:%S"), line, file=sys.stderr, flush=True)
