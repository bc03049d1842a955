"""Comparable times: interleaved runs, medians, and a number of threads for each."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Hashable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from statistics import median
from typing import Any, TypeVar

import torch

from scoup.base import Progress, no_progress

Key = TypeVar("Key", bound=Hashable)
Result = TypeVar("Result")

MOST_IN_A_ROW = 50


@contextmanager
def torch_threads(count: int | None) -> Iterator[None]:
    """Make torch, and backends that follow it, use ``count`` threads in the block; None changes nothing."""
    before = torch.get_num_threads()
    torch.set_num_threads(before if count is None else count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


@dataclass(frozen=True)
class DeviceClock:
    """Seconds on a device: by a GPU's own events, elsewhere by the system's clock."""

    device: str = "cpu"

    @property
    def on_gpu(self) -> bool:
        return self.device.startswith("cuda")

    def settle(self) -> None:
        """Wait until the device has finished."""
        if self.on_gpu:
            torch.cuda.synchronize(self.device)

    def seconds(self, run: Callable[[], object], runs: int = 1) -> float:
        """Return the seconds of one run, where ``runs`` follow each other. Results are dropped after the
        clock has stopped."""
        self.settle()
        if not self.on_gpu:
            started = time.perf_counter()
            result = run()
            for _ in range(runs - 1):
                result = run()
            spent = time.perf_counter() - started
            del result
            return spent / runs
        first, last = (torch.cuda.Event(enable_timing=True) for _ in range(2))
        first.record()
        for _ in range(runs):
            run()
        last.record()
        self.settle()
        return first.elapsed_time(last) / 1e3 / runs


@dataclass(frozen=True, eq=False)
class Task:
    """A task to time."""

    run: Callable[[], object]  # the work; what it returns is dropped after the clock has stopped
    threads: int | None = 1  # torch threads it may use; None leaves the number alone
    repeats: int = 5  # how often it is timed, after one run that is not


@dataclass(frozen=True)
class Timing:
    """Seconds of each repetition, in the order they ran."""

    seconds: tuple[float, ...]

    @property
    def median(self) -> float:
        return median(self.seconds)

    def to_dict(self) -> dict[str, float | int]:
        """Return median, least and most seconds and the number of repetitions, for JSON."""
        return {
            "median_s": self.median,
            "min_s": min(self.seconds),
            "max_s": max(self.seconds),
            "repeats": len(self.seconds),
        }


def time_tasks(
    tasks: Mapping[Key, Task],
    device: str = "cpu",
    progress: Progress = no_progress,
    least_seconds: float = 0.0,
) -> dict[Key, Timing]:
    """Time tasks by any key, interleaved: every round runs each once, so that a change of the machine meets all of
    them.

    Rounds go through the tasks forwards and backwards in turn, so that neighbours are timed one right after the other.
    Each task runs once before, untimed. A repetition that would be shorter than ``least_seconds`` is several runs in a
    row, at most 50.
    """
    clock, seconds = DeviceClock(device), {key: list[float]() for key in tasks}
    in_a_row = dict.fromkeys(tasks, 1)
    rounds = max((task.repeats for task in tasks.values()), default=0)
    total, done = sum(task.repeats + 1 for task in tasks.values()), 0

    progress("measure", 0, total)
    for number in range(rounds + 1):  # round 0 warms up
        order = list(tasks.items())
        for key, task in order if number % 2 else reversed(order):
            if number > task.repeats:
                continue
            with torch_threads(task.threads):
                _wake()
                spent = clock.seconds(task.run, in_a_row[key])
            if number:
                seconds[key].append(spent)
            elif spent < least_seconds:
                in_a_row[key] = min(MOST_IN_A_ROW, math.ceil(least_seconds / max(spent, 1e-9)))
            done += 1
            progress("measure", done, total)
    return {key: Timing(tuple(values)) for key, values in seconds.items()}


def _wake() -> None:
    """Let torch start its threads before the clock runs."""
    torch.zeros(1 << 17).add_(1.0)


class Stopwatch:
    """Seconds of calls by name, for steps that need each other's results and so cannot be interleaved.

    Args:
        clock: ``time.process_time`` counts what the processors spent, whatever else the machine does.
    """

    def __init__(self, clock: Callable[[], float] = time.perf_counter) -> None:
        self._clock = clock
        self.seconds: dict[str, list[float]] = {}

    def __call__(self, name: str, run: Callable[..., Result], *arguments: Any, **named: Any) -> Result:
        """Return what ``run`` returns; its seconds are added to those of the name."""
        started = self._clock()
        result = run(*arguments, **named)
        self.seconds.setdefault(name, []).append(self._clock() - started)
        return result


class StageClock:
    """A progress callback that records the seconds of each stage.

    A stage lasts from its first call to the one with done = total. What runs in between is kept under "start" and
    "after STAGE".
    """

    def __init__(self, then: Progress = no_progress) -> None:
        self._then = then
        self._stage = "start"
        self._since = time.perf_counter()
        self.seconds: dict[str, float] = {}

    def __call__(self, stage: str, done: int, total: int) -> None:
        self._turn_to(stage)
        self._then(stage, done, total)
        if done >= total:
            self._turn_to(f"after {stage}")

    def stop(self) -> dict[str, float]:
        """Return seconds by stage, in the order they ran."""
        self._turn_to("stopped")
        return self.seconds

    def _turn_to(self, stage: str) -> None:
        now = time.perf_counter()
        self.seconds[self._stage] = self.seconds.get(self._stage, 0.0) + now - self._since
        self._stage, self._since = stage, now
