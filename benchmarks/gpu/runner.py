"""The runner of stages: each runs in a process of its own, and its results are kept.

A process of its own because a kernel that goes wrong can leave a device that answers nothing more. What ends a process,
breaks its device or hangs costs its own row: the stage goes on in another process, without it.
"""

from __future__ import annotations

import importlib
import math
import multiprocessing
import os
import signal
import sys
import time
import traceback
import warnings
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

from benchmarks.gpu import ROOT
from benchmarks.gpu.stage import NO_TIME, Row, Sizes, Stage, reason

STAGES = {
    "parity": "Parity with the reference",
    "timing": "One view",
    "build": "The whole build",
}
"""Modules and functions, and the headings of their tables, in the order they run."""
RESERVE = 15.0  # seconds before the end after which nothing is begun
STARTS = 20  # processes that one stage may use up

Launch = Callable[..., tuple[Connection, Any]]


@dataclass(eq=False)
class Runner:
    """Runs stages; ``launch`` starts their processes."""

    results: dict[str, dict[str, Any]]  # by stage; takes what they find
    sizes: Sizes
    interpreted: bool  # kernels, on the CPU
    write: Callable[[], None]  # called whenever more is known
    launch: Launch

    def run(self, name: str, end: float = math.inf) -> None:
        """Run a stage, until ``end`` (seconds since the epoch) at most."""
        print(f"{time.strftime('%H:%M:%S')} {name}", file=sys.stderr, flush=True)
        left_out: dict[str, str] = {}
        result = self.results.setdefault(name, {"rows": []})
        known: dict[str, Row] = {}
        for _ in range(STARTS):
            if time.time() > end - RESERVE:
                result["reason"] = NO_TIME
                break
            process = self.launch(name, self.sizes, self.interpreted, end - RESERVE, left_out, known)
            doing, why = self.follow(name, *process, known, end)
            result = self.results[name]
            if not why:
                break
            result["reason"] = why
            if not doing or doing in left_out:
                break
            rows = {row["name"]: row for row in result["rows"]}
            known = {key: row for key, row in rows.items() if "reason" not in row or "outcome" in row}
            left_out[doing] = rows.get(doing, {}).get("reason", why)
            print(f"{name}: {why}; once more, without: {doing}", file=sys.stderr, flush=True)
        self.write()

    def follow(
        self, name: str, receiver: Connection, process: Any, known: dict[str, Row], end: float
    ) -> tuple[str, str]:
        """Keep what a process sends until it ends, is silent for too long, or the time is up.

        Returns what it did last, and why it has ended: "" where the stage is complete.
        """
        doing, why, quiet_s = "", "", self.sizes.quiet_s
        try:
            while True:
                if not receiver.poll(max(0.0, min(quiet_s, end - time.time()))):
                    why = f"stopped: {NO_TIME}" if time.time() >= end else "it hung and was stopped"
                    break
                kind, *content = receiver.recv()
                if kind == "next":
                    doing, quiet_s = content
                elif kind != "alive":
                    self.results[name] = merge_rows(content[0], known)
                    if kind == "end":
                        break
                    self.results[name].setdefault("reason", "not finished when this was written")
                    self.write()
        except (EOFError, OSError):
            process.join(30.0)
            why = f"its process ended with {process.exitcode}"
        finally:
            kill(process)
        return doing, why


def kill(process: Any) -> None:
    """End a process and what it has started. One that waits for a device listens to nothing less."""
    with suppress(OSError):
        os.killpg(process.pid, signal.SIGKILL)
    process.kill()
    process.join(10.0)


def launch(*arguments: Any) -> tuple[Connection, Any]:
    """Start ``work`` with these arguments in a process; what it sends, and the process."""
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=work, args=(sender, *arguments))
    process.start()
    sender.close()
    return receiver, process


def work(
    sender: Connection,
    name: str,
    sizes: Sizes,
    interpreted: bool,
    deadline: float,
    left_out: dict[str, str],
    known: dict[str, Row],
) -> None:
    """Run a stage; the entry of its process."""
    os.setsid()  # it and what it starts are ended together, and not by the signals of a terminal
    sys.path.insert(0, str(ROOT / "tests"))
    if interpreted and name != "parity":  # whose tests do so themselves
        from interpreting import interpret_kernels

        interpret_kernels()  # before triton is imported
        warnings.filterwarnings("ignore", category=RuntimeWarning)  # of numpy, in the interpreter
    import torch

    device = torch.device("cpu" if interpreted else "cuda")
    stage = Stage(device, sizes, deadline, sender.send, left_out, known)
    try:
        getattr(importlib.import_module(f"benchmarks.gpu.{name}"), name)(stage)
    except Exception as error:
        stage.result.update(reason=reason(error), traceback=traceback.format_exc()[-3000:])
    sender.send(("end", stage.result))
    sender.close()


def merge_rows(result: dict[str, Any], known: dict[str, Row]) -> dict[str, Any]:
    """Return a result with the rows that an earlier process knew and this one does not (yet)."""
    failed = {row["name"] for row in result["rows"] if "reason" in row}
    rows = [known[row["name"]] if row["name"] in failed & set(known) else row for row in result["rows"]]
    there = {row["name"] for row in rows}
    return {**result, "rows": rows + [row for name, row in known.items() if name not in there]}
