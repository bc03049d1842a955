"""The runner of stages: each runs in a process of its own, and its results are kept.

A process of its own because a kernel that goes wrong can leave a device that answers nothing more: that costs the rest
of its stage.
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
from benchmarks.gpu.stage import NO_TIME, Sizes, Stage, reason

STAGES = {
    "parity": "Parity with the reference",
    "timing": "One view",
    "build": "The whole build",
}
"""Modules and functions, and the headings of their tables, in the order they run."""
RESERVE = 15.0  # seconds before the end after which nothing is begun

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
        self.results[name] = {"rows": [], "reason": NO_TIME}
        if time.time() < end - RESERVE:
            self.results[name] = self.follow(
                name, *self.launch(name, self.sizes, self.interpreted, end - RESERVE), end
            )
        self.write()

    def follow(self, name: str, receiver: Connection, process: Any, end: float) -> dict[str, Any]:
        """Keep what a process sends until it ends or the time is up; what it sent last, and why there is no more."""
        result: dict[str, Any] = {"rows": []}
        why = f"stopped: {NO_TIME}"
        try:
            while time.time() < end:
                if receiver.poll(max(0.0, min(10.0, end - time.time()))):
                    result = receiver.recv()
                    self.results[name] = {"reason": "not finished when this was written", **result}
                    self.write()
        except (EOFError, OSError):
            process.join(30.0)
            why = f"its process ended with {process.exitcode}" if process.exitcode else ""
        finally:
            kill(process)
        return {**result, "reason": why} if why else result


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
    stage = Stage(device, sizes, deadline, sender.send)
    try:
        getattr(importlib.import_module(f"benchmarks.gpu.{name}"), name)(stage)
    except Exception as error:
        stage.result.update(reason=reason(error), traceback=traceback.format_exc()[-3000:])
    sender.send(stage.result)
    sender.close()
