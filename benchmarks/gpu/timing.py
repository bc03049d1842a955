"""Times and memory of things that may fail, measured side by side."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from statistics import median
from typing import Any

import torch

LEAST_SECONDS = 0.02  # of a repetition: what is shorter is run several times in a row
MOST_RUNS = 50
TIMES = ("median_s", "min_s", "max_s", "repeats", "runs_a_repeat", "over")

Row = dict[str, Any]


class Unavailable(Exception):
    """Something that cannot be measured here, and why."""


class DeviceLost(Exception):
    """The device answers nothing any more; only a new process can use it."""


@dataclass(frozen=True, eq=False)
class Work:
    """Something to measure.

    Attributes:
        name: of its row.
        run: the work; what it returns is dropped. It may raise: that is the row's reason.
        note: what a reader should know of it.
    """

    name: str
    run: Callable[[], object]
    note: str = ""


@dataclass(frozen=True)
class Clock:
    """Times on one device: by its own events on a GPU, by the system's clock on a CPU."""

    device: torch.device

    @property
    def on_gpu(self) -> bool:
        return self.device.type == "cuda"

    def settle(self) -> None:
        """Wait until nothing runs."""
        if self.on_gpu:
            torch.cuda.synchronize(self.device)

    def seconds(self, run: Callable[[], object], runs: int = 1) -> float:
        """Of one run, of ``runs`` in a row."""
        self.settle()
        if not self.on_gpu:
            started = time.perf_counter()
            for _ in range(runs):
                run()
            return (time.perf_counter() - started) / runs
        first, last = (torch.cuda.Event(enable_timing=True) for _ in range(2))
        first.record()
        for _ in range(runs):
            run()
        last.record()
        self.settle()
        return first.elapsed_time(last) / 1e3 / runs

    def memory(self, run: Callable[[], object]) -> dict[str, int | None]:
        """Most memory allocated while it runs, in bytes, and how much of that was not before; None on a CPU."""
        if not self.on_gpu:
            run()
            return {"peak_bytes": None, "working_bytes": None}
        self.settle()
        torch.cuda.reset_peak_memory_stats(self.device)
        before = torch.cuda.memory_allocated(self.device)
        run()
        self.settle()
        peak = torch.cuda.max_memory_allocated(self.device)
        return {"peak_bytes": peak, "working_bytes": peak - before}

    def recover(self) -> None:
        """Free what a failed run left behind.

        Raises:
            DeviceLost: a kernel has broken the context.
        """
        if not self.on_gpu:
            return
        try:
            self.settle()
            torch.cuda.empty_cache()
        except RuntimeError as error:
            raise DeviceLost(reason(error)) from error


def measure(
    works: Iterable[Work],
    clock: Clock,
    repeats: int,
    time_is_up: Callable[[], bool] = lambda: False,
    warm_up: bool = True,
    into: list[Row] | None = None,
    about_to: Callable[[str], str | None] = lambda name: None,
    known: Callable[[], None] = lambda: None,
) -> list[Row]:
    """A row for each work: seconds, memory, or the reason why there are none.

    Rounds go through the works forwards and backwards in turn, so that a change of the device's clock meets all of
    them. Each has run three times before, untimed: the first run compiles kernels, the second tells the memory, the
    third how often it must run in a row. Until the rounds begin, and where they never do, that third run is what the
    row tells, with ``repeats`` 0. Nothing empties the device's caches between runs.

    Args:
        works: what to measure; names are unique.
        clock: of the device.
        repeats: rounds.
        time_is_up: nothing more is begun once it says so.
        warm_up: false where times mean nothing.
        into: a list that gets the rows, too, even if the device is lost on the way.
        about_to: told the name of a work before it runs; may give a reason to leave it out.
        known: called whenever the rows tell more than before.
    """
    works = list(works)
    rows: list[Row] = [] if into is None else into
    own: dict[str, Row] = {}
    seconds: dict[str, list[float]] = {}
    estimates: dict[str, float] = {}
    runs: dict[str, int] = {}
    for work in works:
        own[work.name] = {"name": work.name, **({"note": work.note} if work.note else {})}
    rows += own.values()

    def attempt(work: Work, run: Callable[[], None]) -> None:
        try:
            run()
        except Exception as error:
            seconds.pop(work.name, None)
            _give_up(own[work.name], error, clock)

    def begin(work: Work) -> None:
        runs[work.name] = 1
        if warm_up:
            estimates[work.name] = _warm_up(work, own[work.name], clock)
            wanted = math.ceil(LEAST_SECONDS / max(estimates[work.name], 1e-9))
            runs[work.name] = max(1, min(MOST_RUNS, wanted))
        seconds[work.name] = []

    def tell() -> None:
        for name, values in seconds.items():
            found = values or [estimates[name]] if values or name in estimates else []
            if found:
                own[name].update(
                    median_s=median(found),
                    min_s=min(found),
                    max_s=max(found),
                    repeats=len(values),
                    runs_a_repeat=runs[name] if values else 1,
                )
        known()

    try:
        for work in works:
            left_out = about_to(work.name)
            if left_out is not None or time_is_up():
                own[work.name]["reason"] = left_out or "no time was left"
                continue
            attempt(work, partial(begin, work))
            tell()
        for number in range(repeats):
            for work in works if number % 2 else reversed(works):
                if work.name not in seconds or (time_is_up() and (number or warm_up)):
                    continue
                about_to(work.name)
                attempt(
                    work,
                    lambda work=work: seconds[work.name].append(clock.seconds(work.run, runs[work.name])),
                )
            tell()
    finally:  # what is known stays where the device is lost
        tell()
        for row in own.values():
            if "median_s" not in row:
                row.setdefault("reason", "it was not timed before the device was lost")
    return list(own.values())


def _warm_up(work: Work, row: Row, clock: Clock) -> float:
    """Run it three times, note what they tell in its row, and give the seconds of the last."""
    row["first_run_s"] = clock.seconds(work.run)
    row.update(clock.memory(work.run))
    return clock.seconds(work.run)


def measure_once(work: Work, clock: Clock) -> Row:
    """A row for something that takes long: one run, by the system's clock, with its memory."""
    row: Row = {"name": work.name}
    if work.note:
        row["note"] = work.note
    try:
        clock.settle()
        started = time.perf_counter()
        row.update(clock.memory(work.run))
        spent = time.perf_counter() - started
    except Exception as error:
        _give_up(row, error, clock)
        return row
    row.update(median_s=spent, min_s=spent, max_s=spent, repeats=1, runs_a_repeat=1)
    return row


def _give_up(row: Row, error: Exception, clock: Clock) -> None:
    row["reason"] = reason(error)
    for key in TIMES:
        row.pop(key, None)
    # Only its text is kept: the error itself would hold on to all tensors of the frames that it came through.
    error.__traceback__ = None
    clock.recover()


def reason(error: BaseException) -> str:
    """An error in one line; of a long one the beginning."""
    text = " ".join(str(error).split())
    text = text if len(text) <= 400 else text[:400] + " ..."
    return text if isinstance(error, Unavailable) and text else f"{type(error).__name__}: {text}"


def add_ratios(rows: list[Row], over: dict[str, list[str]]) -> None:
    """Into each row with a time, its time over that of other rows: ``over`` maps what the other is called to the
    names of its rows, of which the fastest counts.
    """
    times = {row["name"]: row["median_s"] for row in rows if "median_s" in row}
    for called, names in over.items():
        found = [times[name] for name in names if name in times]
        if found:
            for row in rows:
                if "median_s" in row and row["name"] not in names:
                    row.setdefault("over", {})[called] = row["median_s"] / min(found)
