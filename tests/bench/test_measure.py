"""Medians, turns and threads."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch

from scoup_lab.bench import measure
from scoup_lab.bench.measure import StageClock, Task, Timing, time_tasks, torch_threads


def test_tasks_take_turns_under_their_threads():
    before = torch.get_num_threads()
    ran: list[tuple[str, int]] = []
    tasks = {
        "a": Task(lambda: ran.append(("a", torch.get_num_threads())), 1, 3),
        "b": Task(lambda: ran.append(("b", torch.get_num_threads())), 2, 1),
    }
    reported: list[tuple[int, int]] = []
    timings = time_tasks(tasks, progress=lambda _, done, total: reported.append((done, total)))
    # Round 0 warms up; rounds go forwards and backwards in turn; b has had enough after one.
    assert "".join(name for name, _ in ran) == "ba" + "ab" + "a" + "a"
    assert set(ran) == {("a", 1), ("b", 2)}
    assert {key: len(timing.seconds) for key, timing in timings.items()} == {"a": 3, "b": 1}
    assert reported[0] == (0, 6)
    assert reported[-1] == (6, 6)
    assert torch.get_num_threads() == before
    assert time_tasks({}) == {}


def test_threads_are_restored_after_an_error():
    before = torch.get_num_threads()

    def fail() -> None:
        with torch_threads(before + 1):
            assert torch.get_num_threads() == before + 1
            raise RuntimeError("oh")

    with pytest.raises(RuntimeError, match="oh"):
        fail()
    assert torch.get_num_threads() == before


def test_medians():
    timing = Timing((3.0, 1.0, 2.0, 9.0))
    assert timing.median == 2.5
    assert timing.to_dict() == {"median_s": 2.5, "min_s": 1.0, "max_s": 9.0, "repeats": 4}


def test_the_clock_of_stages(monkeypatch: pytest.MonkeyPatch):
    now = [0.0]
    monkeypatch.setattr(measure.time, "perf_counter", lambda: now[0])
    reported: list[str] = []
    clock = StageClock(lambda stage, done, total: reported.append(f"{stage} {done}/{total}"))
    calls = [("coding", 0, 2), ("coding", 1, 2), ("coding", 2, 2), ("uplift", 0, 1), ("uplift", 1, 1)]
    for power, call in enumerate(calls):
        now[0] += 2.0**power
        clock(*call)
    now[0] += 32.0
    found = {"start": 1.0, "coding": 6.0, "after coding": 8.0, "uplift": 16.0, "after uplift": 32.0}
    assert clock.stop() == found
    assert reported == ["coding 0/2", "coding 1/2", "coding 2/2", "uplift 0/1", "uplift 1/1"]


def test_short_runs_are_repeated_in_a_row(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr(measure.time, "perf_counter", lambda: now[0])

    def take(seconds: float) -> Callable[[], None]:
        def run() -> None:
            now[0] += seconds
            ran.append(seconds)

        return run

    ran: list[float] = []
    tasks = {seconds: Task(take(seconds), repeats=1) for seconds in (0.25, 2.0, 1e-6)}
    timings = time_tasks(tasks, least_seconds=1.0)
    assert [ran.count(seconds) for seconds in tasks] == [1 + 4, 1 + 1, 1 + measure.MOST_IN_A_ROW]
    assert all(timings[seconds].median == pytest.approx(seconds, rel=1e-3) for seconds in tasks)
