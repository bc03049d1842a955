"""The whole run: parity, then the stages in a process of their own, and the files written as results come in."""

from __future__ import annotations

import contextlib
import multiprocessing
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from pathlib import Path
from typing import Any

from benchmarks.gpu.machine import describe_machine
from benchmarks.gpu.parity import run_parity
from benchmarks.gpu.report import report
from benchmarks.gpu.sizes import Sizes
from benchmarks.gpu.worker import STAGES, work_through
from scoup.bench import write_json
from scoup.io import write_text

GRACE = 20.0  # seconds beyond the deadline before what hangs is stopped
UNFINISHED = "not finished when this was written"
SHARE_OF_PARITY = 0.5  # most of the time that is left


def conduct(
    out: Path,
    sizes: Sizes,
    stages: Sequence[str],
    mode: str,
    interpreted: bool = False,
    parity: bool = True,
    only: str = "",
    budget_s: float | None = None,
) -> dict[str, Any]:
    """Run everything and write ``out`` (JSON) and the same with .md, anew after each thing that is known.

    Args:
        out: the JSON file; replaced.
        sizes: of everything.
        stages: names, in order.
        mode: "full", "quick" or "smoke", for the record.
        interpreted: with interpreted kernels.
        parity: run the parity suite first.
        only: of the suite, an expression of pytest's ``-k``.
        budget_s: seconds for all; what does not fit is left out and says so.

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
        "stages": {},
        "finished": False,
    }

    def write() -> None:
        record["seconds"] = time.time() - started
        write_json(out, record, overwrite=True)
        write_text(out.with_suffix(".md"), report(record), overwrite=True)

    write()
    try:
        if parity:
            say("parity suite")
            left = None if budget_s is None else max(1.0, SHARE_OF_PARITY * (deadline - time.time()))
            record["parity"] = run_parity(left, only)
            write()
        run_stages(record, sizes, stages, interpreted, deadline, write)
        record["finished"] = True
    except KeyboardInterrupt:
        record["reason"] = "interrupted"
        raise
    finally:
        write()
    return record


def run_stages(
    record: dict[str, Any],
    sizes: Sizes,
    stages: Sequence[str],
    interpreted: bool,
    deadline: float,
    write: Callable[[], None],
) -> None:
    """Have the stages run; where a process ends early, another takes the stages that are left."""
    results: dict[str, dict[str, Any]] = record["stages"]
    left = list(stages)
    while left:
        ceilings = results.get("ceilings", {}).get("ceilings", {})
        context = multiprocessing.get_context("spawn")
        receiver, sender = context.Pipe(duplex=False)
        arguments = (left, sizes, interpreted, deadline, ceilings, sender)
        process = context.Process(target=work_through, args=arguments)
        process.start()
        sender.close()
        try:
            running, ended = listen(receiver, results, deadline, write)
        finally:
            why = stop(process, deadline)
        if running is None and not ended:  # it did not even begin
            running = left[0]
            results[running] = {"rows": []}
        if running is not None:
            results[running]["reason"] = why
            write()
        left = [name for name in left if name not in results]


def listen(
    receiver: Connection, results: dict[str, dict[str, Any]], deadline: float, write: Callable[[], None]
) -> tuple[str | None, int]:
    """Take in what a process sends until it ends or the time is up: the stage it was in, and how many it has ended."""
    running: str | None = None
    ended = 0
    while True:
        wait = None if deadline == float("inf") else max(0.0, deadline + GRACE - time.time())
        if not receiver.poll(wait):
            return running, ended
        try:
            message = receiver.recv()
        except EOFError:
            return running, ended
        kind, name = message[:2]
        if kind == "begin":
            say(f"{name}: {STAGES[name][1]}")
            running = name
            results[name] = {"rows": [], "reason": UNFINISHED}
            continue
        results[name] = message[2]
        if kind == "end":
            running, ended = None, ended + 1
        else:
            results[name].setdefault("reason", UNFINISHED)
        write()


def stop(process: SpawnProcess, deadline: float) -> str:
    """See that the process has ended; why it did."""
    process.join(5.0)
    if process.is_alive():
        process.terminate()
        process.join(5.0)
        if process.is_alive():
            process.kill()
            process.join()
        return "stopped: no time was left" if time.time() > deadline else "stopped"
    return f"its process ended with {process.exitcode}"


def say(line: str) -> None:
    with contextlib.suppress(OSError):
        print(line, file=sys.stderr, flush=True)
