"""Times one can compare: interleaved runs, medians, threads set for each; how time grows with size."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from statistics import median
from typing import TypeVar

import torch

from scoup.base.errors import InputError
from scoup.base.progress import Progress, no_progress

Key = TypeVar("Key", bound=Hashable)


@contextmanager
def torch_threads(count: int) -> Iterator[None]:
    """torch (and every backend that follows it) uses ``count`` threads inside the block."""
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


@dataclass(frozen=True, eq=False)
class Task:
    """Something to time.

    Attributes:
        run: the work; what it returns is dropped after the clock has stopped.
        threads: torch threads it may use.
        repeats: how often it is timed, after one run that is not.
    """

    run: Callable[[], object]
    threads: int = 1
    repeats: int = 5


@dataclass(frozen=True)
class Timing:
    """Seconds of each repetition, in the order they ran."""

    seconds: tuple[float, ...]

    @property
    def median(self) -> float:
        return median(self.seconds)

    def record(self) -> dict[str, float | int]:
        """For JSON: median, least and most seconds, and the number of repetitions."""
        return {
            "median_s": self.median,
            "min_s": min(self.seconds),
            "max_s": max(self.seconds),
            "repeats": len(self.seconds),
        }


def time_tasks(
    tasks: Mapping[Key, Task], device: str = "cpu", progress: Progress = no_progress
) -> dict[Key, Timing]:
    """Time tasks interleaved: every round runs each task once, so that a change of the machine meets all of them.

    Rounds go through the tasks forwards and backwards in turn. Each task runs once before, untimed.

    Args:
        tasks: by any key; neighbours are timed one right after the other.
        device: what to wait for before the clock is read.
        progress: told of each run.

    Returns:
        Timings under the same keys.
    """
    seconds: dict[Key, list[float]] = {key: [] for key in tasks}
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
                spent = _time(task.run, device)
            if number:
                seconds[key].append(spent)
            done += 1
            progress("measure", done, total)
    return {key: Timing(tuple(values)) for key, values in seconds.items()}


def _wake() -> None:
    """Let torch start its threads before the clock runs."""
    torch.zeros(1 << 17).add_(1.0)


def _time(run: Callable[[], object], device: str) -> float:
    _settle(device)
    started = time.perf_counter()
    result = run()
    _settle(device)
    spent = time.perf_counter() - started
    del result
    return spent


def _settle(device: str) -> None:
    if device != "cpu":
        torch.cuda.synchronize(device)


@dataclass(frozen=True)
class Slope:
    """time = constant * size ** slope, fitted by least squares of the logarithms.

    Attributes:
        slope: 1 where time is proportional to size.
        spread: standard error of the slope, NaN where two sizes leave none to estimate.
        constant: in seconds.
    """

    slope: float
    spread: float
    constant: float

    def record(self) -> dict[str, float | None]:
        """For JSON, which has no NaN."""
        return {
            "slope": self.slope,
            "standard_error": None if math.isnan(self.spread) else self.spread,
            "constant_s": self.constant,
        }


def fit_slope(sizes: Sequence[float], seconds: Sequence[float]) -> Slope:
    """Least-squares line through (log size, log seconds).

    Raises:
        InputError: fewer than two different sizes, or a number that is not positive.
    """
    if len(sizes) != len(seconds) or len(set(sizes)) < 2:
        raise InputError(f"a slope needs two or more different sizes with a time each, got {list(sizes)}")
    if min(sizes) <= 0 or min(seconds) <= 0:
        raise InputError("a slope needs positive sizes and times")
    x, y = [math.log(size) for size in sizes], [math.log(value) for value in seconds]
    mean_x, mean_y = sum(x) / len(x), sum(y) / len(y)
    squares = sum((a - mean_x) ** 2 for a in x)
    slope = sum((a - mean_x) * (b - mean_y) for a, b in zip(x, y, strict=True)) / squares
    offset = mean_y - slope * mean_x
    spread = math.nan
    if len(x) > 2:
        left = sum((b - offset - slope * a) ** 2 for a, b in zip(x, y, strict=True))
        spread = math.sqrt(left / (len(x) - 2) / squares)
    return Slope(slope, spread, math.exp(offset))


class StageClock:
    """A progress callback that keeps how long each stage took.

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
        """Seconds by stage, in the order they ran."""
        self._turn_to("stopped")
        return self.seconds

    def _turn_to(self, stage: str) -> None:
        now = time.perf_counter()
        self.seconds[self._stage] = self.seconds.get(self._stage, 0.0) + now - self._since
        self._stage, self._since = stage, now
