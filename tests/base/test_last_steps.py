"""Files that get their names together, whatever ends the process meanwhile."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from cli_support import snapshot
from scoup.base.atomic import atomic_path
from scoup.base.errors import InputError, ScoupWarning, WriteError
from scoup.base.last_steps import LastSteps
from scoup.base.locks import complete, locked_file

# Writes a.scoup, a.scoup.sums from a.scoup.partial, and removes a.scoup.rest; killed before the n-th step of these.
FINISH = """
import os, signal, sys
from pathlib import Path
from scoup.base.atomic import atomic_path
from scoup.base.locks import locked_file
path, last = Path("a.scoup"), int(sys.argv[1])
Path("a.scoup.partial").write_text("new sums")
Path("a.scoup.rest").write_text("rest")
def counted(function):
    def step(*arguments, **more):
        steps.append(1)
        if len(steps) == last:
            os.kill(os.getpid(), signal.SIGKILL)
        return function(*arguments, **more)
    return step
steps = []
with locked_file(path, overwrite=True) as lock:
    moves = {Path("a.scoup.partial"): Path("a.scoup.sums")}
    def move(temporary, target):
        os.replace, Path.unlink = counted(os.replace), counted(Path.unlink)
        os.ftruncate, os.write = counted(os.ftruncate), counted(os.write)
        lock.finish({temporary: target, **moves}, [Path("a.scoup.rest")])
    with atomic_path(path, overwrite=True, move=move) as temporary:
        temporary.write_text("new field")
print(len(steps))
"""
OLD = {"a.scoup": b"old field", "a.scoup.sums": b"old sums"}
NEW = {"a.scoup": b"new field", "a.scoup.sums": b"new sums"}


@pytest.fixture(autouse=True)
def _here(tmp_path: Path) -> Iterator[None]:
    before = Path.cwd()
    os.chdir(tmp_path)
    yield
    os.chdir(before)


def write(files: dict[str, bytes]) -> None:
    for name, content in files.items():
        Path(name).write_bytes(content)


def finished(last: int) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", FINISH, str(last)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    return subprocess.run(command, capture_output=True, text=True, env=environment)


def test_all_or_nothing_wherever_it_is_killed() -> None:
    write(OLD)
    done = finished(0)
    assert done.returncode == 0, done.stderr
    assert snapshot(Path()) == NEW
    outcomes = set()
    # The writing of the lock, both moves, the removal, and what comes after; the contents of the lock come before.
    for last in range(1, int(done.stdout) + 1):
        for path in Path().iterdir():
            path.unlink()
        write(OLD)
        assert finished(last).returncode == -signal.SIGKILL
        left = snapshot(Path())
        if left["a.scoup"] == OLD["a.scoup"] and "last_steps" not in left["a.scoup.lock"].decode():
            complete(Path("a.scoup"))
            outcomes.add("old")
            assert snapshot(Path()) == {**OLD, "a.scoup.partial": b"new sums", "a.scoup.rest": b"rest"}
            continue
        all_moved = left["a.scoup.sums"] == NEW["a.scoup.sums"]
        if all_moved:
            complete(Path("a.scoup"))
        else:
            with pytest.warns(
                ScoupWarning, match=r"^a.scoup: put in place what a killed process had finished \("
            ):
                complete(Path("a.scoup"))
        outcomes.add("after" if all_moved else "between")
        assert snapshot(Path()) == NEW
    assert outcomes == {"old", "between", "after"}


def test_the_next_holder_completes_before_it_looks_whether_the_output_is_there() -> None:
    write({"a.scoup.partial": b"sums"})
    steps = LastSteps.of(Path("a.scoup"), {Path("a.scoup.partial"): Path("a.scoup.sums")}, [])
    holder = {"host": "here", "process": 1, "since": "2026-01-01T00:00:00", "last_steps": steps.record()}
    Path("a.scoup.lock").write_text(json.dumps(holder))
    with pytest.warns(ScoupWarning, match=r"\(a.scoup.sums\)"), locked_file(Path("a.scoup")):
        assert Path("a.scoup.sums").read_bytes() == b"sums"
    assert snapshot(Path()) == {"a.scoup.sums": b"sums"}


@pytest.mark.parametrize(
    "steps",
    [
        {"moves": [["a.scoup.partial", "../precious"]], "removed": []},
        {"moves": [["precious", "a.scoup"]], "removed": []},
        {"moves": [], "removed": ["precious"]},
        {"moves": [], "removed": ["/etc/precious"]},
        {"moves": [["a.scoup.partial"]], "removed": []},
        {"moves": []},
        "steps",
    ],
    ids=str,
)
def test_steps_that_are_not_of_this_output_are_not_taken(steps: object) -> None:
    write({"precious": b"x", "a.scoup.partial": b"y"})
    holder = {"host": "here", "process": 1, "since": "2026-01-01T00:00:00", "last_steps": steps}
    Path("a.scoup.lock").write_text(json.dumps(holder))
    before = snapshot(Path())
    with pytest.raises(InputError, match=r"^a.scoup.lock: is no lock that scoup has written"), \
            locked_file(Path("a.scoup")):  # fmt: skip
        pass
    complete(Path("a.scoup"))  # nor here; and it does not stop what comes after
    assert snapshot(Path()) == before


def test_files_of_other_outputs_are_a_fault_of_the_program() -> None:
    with pytest.raises(ValueError, match="do not belong to the output"), locked_file(Path("a.scoup")) as lock:
        lock.finish({Path("b.scoup.partial"): Path("a.scoup")})
    assert not list(Path().iterdir())


def test_nothing_is_completed_while_its_process_lives() -> None:
    write({"a.scoup.partial": b"sums"})
    with locked_file(Path("a.scoup")):
        before = snapshot(Path())
        complete(Path("a.scoup"))
        assert snapshot(Path()) == before
    complete(Path("a.scoup"))  # nor where there is no lock
    assert snapshot(Path()) == {"a.scoup.partial": b"sums"}


@pytest.mark.parametrize("refused", [1, 2])
def test_a_refused_move_names_the_file_that_it_was_to_make(
    refused: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    write({**OLD, "a.scoup.partial": b"new sums"})
    replace, moved = os.replace, []

    def refuse(first: Path, second: Path) -> None:
        moved.append(second)
        if len(moved) == refused:
            raise PermissionError(13, "Permission denied", str(first))
        replace(first, second)

    def finish() -> None:
        with locked_file(Path("a.scoup"), overwrite=True) as lock:

            def move(first: Path, second: Path) -> None:
                monkeypatch.setattr(os, "replace", refuse)
                lock.finish({first: second, Path("a.scoup.partial"): Path("a.scoup.sums")})

            with atomic_path("a.scoup", overwrite=True, move=move) as path:
                path.write_bytes(b"new field")

    name = ("a.scoup", "a.scoup.sums")[refused - 1]
    with pytest.raises(WriteError, match=rf"^{name}: cannot be written \(Permission denied\)"):
        finish()
    monkeypatch.undo()
    if refused == 1:  # nothing has changed
        assert snapshot(Path()) == {**OLD, "a.scoup.partial": b"new sums"}
        return
    assert snapshot(Path())["a.scoup"] == b"new field"
    with pytest.warns(ScoupWarning, match=r"\(a.scoup.sums\)"):  # the rest, once it is allowed
        complete(Path("a.scoup"))
    assert snapshot(Path()) == NEW
