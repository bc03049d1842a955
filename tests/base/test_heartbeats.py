"""Processes that wait for each other by lock files; threads stand in for them."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import pytest

from scoup.base import heartbeats as module
from scoup.base.errors import ProcessLostError, is_said_elsewhere
from scoup.base.heartbeats import heartbeats, reported_once, wait_for_parts, wait_until_taken
from scoup.base.lock_files import read_record
from scoup.base.locks import lock_path, locked_output
from scoup.base.shares import Share
from support import HANGS

STALE = {"host": "there", "process": 1, "since": "2026-01-01T00:00:00", "id": "a", "ready_for": "b"}


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


WHOLE, PARTS = Path("a.scoup"), [Path("a.1.sums"), Path("a.2.sums")]


def first(fails: bool = False) -> None:
    """Wait for the parts, and take them."""
    with locked_output(WHOLE) as lock, heartbeats(lock):
        wait_for_parts(lock, [lock_path(part) for part in PARTS])
        if fails:
            raise ValueError
        for part in PARTS:
            part.unlink()


def other(part: Path) -> None:
    """Make a part and wait until it is taken."""
    with locked_output(part, overwrite=True) as lock, heartbeats(lock):
        part.write_text("a part")
        wait_until_taken(lock, part, lock_path(WHOLE))


def written(lock: Path) -> dict[str, object]:
    """The record of a lock file; empty where there is none yet, or it is being written."""
    try:
        return read_record(lock) or {}
    except ValueError:
        return {}


def at_once(*work: Callable[[], None]) -> list[BaseException | None]:
    """The errors with which threads end."""
    with ThreadPoolExecutor(len(work)) as threads:
        futures: list[Future[None]] = [threads.submit(one) for one in work]
        return [future.exception(HANGS) for future in futures]


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize("stale", [False, True])
def test_all_wait_for_all(stale: bool) -> None:
    """Whatever earlier, killed processes have left."""
    for path in (WHOLE, *PARTS) if stale else ():
        lock_path(path).write_text(json.dumps(STALE) + " " * 200)
    assert at_once(*(lambda part=part: other(part) for part in PARTS), first) == [None] * 3
    assert not list(Path().iterdir())


@pytest.mark.usefixtures("here")
def test_what_a_dead_process_has_left_is_no_heartbeat(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "SILENCE", 0.5)
    for part in PARTS:
        lock_path(part).write_text(json.dumps(STALE))
    with pytest.raises(ProcessLostError, match=r"\(a.1.sums.lock: no heartbeat for 0 s\)"):
        first()
    lock_path(WHOLE).write_text(json.dumps(STALE))
    with pytest.raises(ProcessLostError, match=r"\(a.scoup.lock: no heartbeat for 0 s\)") as caught:
        other(PARTS[0])
    assert not is_said_elsewhere(caught.value)


@pytest.mark.usefixtures("here")
def test_if_the_first_fails_the_others_end_and_leave_it_to_the_first_to_say_so() -> None:
    *others, error = at_once(*(lambda part=part: other(part) for part in PARTS), lambda: first(fails=True))
    assert isinstance(error, ValueError)
    for lost in others:
        assert isinstance(lost, ProcessLostError)
        assert "a.scoup.lock was abandoned" in str(lost)
        assert is_said_elsewhere(lost)


@pytest.mark.usefixtures("here")
def test_if_another_fails_the_first_says_so() -> None:
    def fails() -> None:
        with locked_output(PARTS[1]) as lock, heartbeats(lock):
            # Two heartbeats of the first: by then it has looked at both parts, again and again.
            while int(str(written(lock_path(WHOLE)).get("beat", 0))) < 2:
                time.sleep(0.01)

    found = at_once(lambda: other(PARTS[0]), fails, first)
    assert [type(error) for error in found] == [ProcessLostError, type(None), ProcessLostError]
    assert "a.2.sums.lock was abandoned" in str(found[2])
    assert [is_said_elsewhere(error) for error in found] == [True, False, False]


@pytest.mark.parametrize(
    ("error", "said"),
    [(KeyboardInterrupt(), [0]), (ProcessLostError("x"), [0, 1]), (ValueError(), [0, 1, 2])],
)
def test_who_reports_the_end_of_all(error: BaseException, said: list[int]) -> None:
    reported = []
    for number in range(3):
        mine = type(error)(*error.args)
        with pytest.raises(type(error)), reported_once(Share(number, 3)):
            raise mine
        if not is_said_elsewhere(mine):
            reported.append(number)
    assert reported == said
