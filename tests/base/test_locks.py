"""One process at a time writes an output."""

from __future__ import annotations

import json
import os
import pickle
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from scoup.base.atomic import atomic_file
from scoup.base.errors import InputError, OutputExistsError, OutputInUseError
from scoup.base.locks import locked_folder, locked_output
from scoup.base.shares import Share
from scoup.base.staging import staged

HOLD = """
import sys
from pathlib import Path
from scoup.base.atomic import atomic_path
from scoup.base.locks import locked_output, locked_folder
from scoup.base.staging import staged
path = Path(sys.argv[2])
kinds = {"file": locked_output, "folder": locked_folder, "staged": staged, "nothing": atomic_path}
with kinds[sys.argv[1]](path) as made:
    if sys.argv[1] == "staged":
        (made / "half").write_text("half")
    if sys.argv[1] == "nothing":
        made.write_text("half")
    print("held", flush=True)
    sys.stdin.read()
"""


@contextmanager
def another_process(what: str, path: Path) -> Iterator[subprocess.Popen[str]]:
    """A process that holds a path until the block ends, or it is killed."""
    command = [sys.executable, "-c", HOLD, what, str(path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "held\n"
        yield process


def test_the_second_is_refused_with_the_name_of_the_holder(tmp_path: Path) -> None:
    path = tmp_path / "a.scoup"
    with another_process("file", path) as other:
        with pytest.raises(OutputInUseError) as refused, locked_output(path):
            pass
        message = str(refused.value)
        start = f"{path}: is being written by process {other.pid} on {socket.gethostname()} since "
        assert message.startswith(start)
        since = message.removeprefix(start).partition(";")[0]
        assert re.fullmatch(r"(\d{4}-\d\d-\d\d )?\d\d:\d\d", since)  # the date where midnight has passed
        assert message.endswith("; wait for it, or choose another output")
        assert str(pickle.loads(pickle.dumps(refused.value))) == message
        with locked_output(tmp_path / "b.scoup"):  # another output
            pass
    assert not list(tmp_path.iterdir())  # it was removed by the other at its end
    with locked_output(path):
        assert json.loads((tmp_path / "a.scoup.lock").read_text())["process"] == os.getpid()
    assert not list(tmp_path.iterdir())


def test_the_lock_of_a_dead_process_is_taken_over(tmp_path: Path) -> None:
    path = tmp_path / "a.scoup"
    with another_process("file", path) as other:
        other.kill()
        other.wait()
    assert (tmp_path / "a.scoup.lock").exists()
    with locked_output(path):
        assert json.loads((tmp_path / "a.scoup.lock").read_text())["process"] == os.getpid()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, SystemExit])
def test_it_is_given_up_after_an_error(tmp_path: Path, error: type[BaseException]) -> None:
    def work() -> None:
        with locked_output(tmp_path / "new" / "a.scoup"):
            assert (tmp_path / "new" / "a.scoup.lock").exists()
            raise error

    with pytest.raises(error):
        work()
    assert not list(tmp_path.iterdir())  # nor does the folder stay that was made for it


def test_what_another_process_has_just_finished_is_not_made_again(tmp_path: Path) -> None:
    path = tmp_path / "a.scoup"
    path.write_text("precious")
    with pytest.raises(OutputExistsError), locked_output(path):
        pass
    with locked_output(path, overwrite=True):
        pass
    assert path.read_text() == "precious"
    assert [item.name for item in tmp_path.iterdir()] == ["a.scoup"]


def test_a_folder(tmp_path: Path) -> None:
    folder = tmp_path / "deep" / "folder"
    with another_process("folder", folder), pytest.raises(OutputInUseError, match=f"^{folder}: is being"), \
            locked_folder(folder):  # fmt: skip
        pass
    assert not list(folder.iterdir())
    (tmp_path / "file").write_text("x")
    with pytest.raises(InputError, match="is a file"), locked_folder(tmp_path / "file"):
        pass


def test_what_a_killed_process_left_is_removed(tmp_path: Path) -> None:
    path = tmp_path / "a.scoup"
    for output in (path, tmp_path / "a.scoup.sums", tmp_path / "b.scoup"):
        with another_process("nothing", output) as other:
            other.kill()
            other.wait()
    precious = [
        ".a.scoup",
        ".a.backup.scoup",
        "a.0123456789ab.scoup",
        ".a.0123456789ab.ply",
        ".ab.0123456789ab.scoup",
    ]
    for name in precious:
        (tmp_path / name).write_text("x")
    assert len(list(tmp_path.iterdir())) == 3 + len(precious)
    with locked_output(path):
        pass
    left = {item.name for item in tmp_path.iterdir()} - set(precious)
    (other_output,) = left
    assert other_output.startswith(".b.")


def test_what_a_living_process_writes_by_itself_stays(tmp_path: Path) -> None:
    path = tmp_path / "a.scoup"
    with another_process("nothing", path) as other:
        for lock in (locked_output(path), locked_folder(tmp_path)):
            with lock:
                pass
        other.communicate("")
        assert other.returncode == 0
    assert path.read_text() == "half"


def test_files_of_users_with_names_like_ours_stay(tmp_path: Path) -> None:
    (tmp_path / ".scoup-notes").write_text("precious")
    (tmp_path / ".scoup-0123456789ab").write_text("precious")  # a file: ours are folders
    (tmp_path / ".scoup-cache").mkdir()
    (tmp_path / ".scoup-0123456789abc").mkdir()
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / ".scoup-0123456789ac").symlink_to("elsewhere")
    (tmp_path / ".scoup-0123456789ad").mkdir()  # what a killed process has left
    before = {item.name for item in tmp_path.iterdir()}
    with staged(tmp_path):
        pass
    assert before - {item.name for item in tmp_path.iterdir()} == {".scoup-0123456789ad"}


def test_a_hidden_folder_that_was_taken_for_abandoned_is_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By a process that came between making it and holding it."""
    make, made = Path.mkdir, []

    def and_removed(path: Path, *how, **more) -> None:
        make(path, *how, **more)
        if path.name.startswith(".scoup-"):
            made.append(path)
            if len(made) == 1:
                path.rmdir()

    monkeypatch.setattr(Path, "mkdir", and_removed)
    with staged(tmp_path) as hidden:
        (hidden / "a").write_text("x")
    assert len(made) == 2
    assert [item.name for item in tmp_path.iterdir()] == ["a"]


@pytest.mark.parametrize(
    ("number", "error"), [(signal.SIGINT, KeyboardInterrupt), (signal.SIGTERM, SystemExit)]
)
def test_files_move_together_though_interrupted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: signal.Signals, error: type[BaseException]
) -> None:
    for name in "ab":
        (tmp_path / name).write_text("old")
    move = os.replace

    def moved(source: Path, target: Path) -> None:
        move(source, target)
        signal.raise_signal(number)

    def stop(*_) -> None:
        raise error

    def write() -> None:
        with staged(tmp_path, overwrite=True) as hidden:
            for name in "ab":
                (hidden / name).write_text("new")
            monkeypatch.setattr(os, "replace", moved)

    before = signal.signal(number, stop)
    try:
        with pytest.raises(error):
            write()
        assert signal.getsignal(number) is stop
    finally:
        signal.signal(number, before)
    assert {item.name: item.read_text() for item in tmp_path.iterdir()} == {"a": "new", "b": "new"}


def test_processes_at_work_in_one_folder(tmp_path: Path) -> None:
    """They keep a lone process out, to the last, and a lone one keeps each of them out."""
    first, second = Share(0, 2), Share(1, 2)
    with another_process("folder", tmp_path) as other:
        for share in (first, second):
            with pytest.raises(OutputInUseError, match=f"by process {other.pid} "), \
                    locked_folder(tmp_path, share):  # fmt: skip
                pass
    with locked_folder(tmp_path, second):
        with locked_folder(tmp_path, first), pytest.raises(OutputInUseError), locked_folder(tmp_path, first):
            pass
        with pytest.raises(OutputInUseError, match=f"by process {os.getpid()} "), locked_folder(tmp_path):
            pass
        assert [item.name for item in tmp_path.iterdir()] == ["scoup.lock.2-of-2"]
    assert not list(tmp_path.iterdir())


def test_locks_of_dead_processes_at_work_in_one_folder_are_removed(tmp_path: Path) -> None:
    with locked_folder(tmp_path, Share(0, 2)):
        record = (tmp_path / "scoup.lock.1-of-2").read_text()
    for name in ("scoup.lock", "scoup.lock.1-of-2", "scoup.lock.2-of-2"):
        (tmp_path / name).write_text(record)
    (tmp_path / "scoup.lock.txt").write_text("precious")
    with locked_folder(tmp_path, Share(0, 2)):
        pass
    with locked_folder(tmp_path):
        pass
    assert [item.name for item in tmp_path.iterdir()] == ["scoup.lock.txt"]


def test_what_a_living_process_writes_stays(tmp_path: Path) -> None:
    with locked_folder(tmp_path), atomic_file(tmp_path / "a.regions") as stream:
        stream.write(b"of one of several processes")
        for item in list(tmp_path.glob("scoup.lock")):
            item.unlink()  # as if the first of them had only now begun
        with locked_folder(tmp_path):
            pass
    assert (tmp_path / "a.regions").exists()


def test_hidden_folders_of_killed_processes_are_removed(tmp_path: Path) -> None:
    with another_process("staged", tmp_path / "a") as other, another_process("staged", tmp_path / "b"):
        other.kill()
        other.wait()
        assert len(list(tmp_path.iterdir())) == 2
        with staged(tmp_path / "c") as hidden:
            (hidden / "whole").write_text("whole")
            assert len(list(tmp_path.iterdir())) == 2  # its own, and that of the living
    assert sorted(item.name for item in tmp_path.iterdir()) == ["b", "c"]
    assert (tmp_path / "b" / "half").read_text() == "half"  # the living one was not disturbed


@pytest.mark.parametrize(
    "contents", ["not JSON", "{}", "[1]", '{"process": 1, "host": "a", "since": 5}', "x" * 9000]
)
def test_a_file_of_other_contents_is_no_lock(tmp_path: Path, contents: str) -> None:
    path = tmp_path / "a.scoup.lock"
    path.write_text(contents)
    with pytest.raises(InputError, match=f"^{path}: is not a SCOUP lock file; move it"), \
            locked_output(tmp_path / "a.scoup"):  # fmt: skip
        pass
    assert path.read_text() == contents


@pytest.mark.parametrize("contents", [b"", bytes(90)])
def test_a_file_without_a_record_is_a_lock(tmp_path: Path, contents: bytes) -> None:
    """Of a process that was killed, or lost power, before its record was on the disk."""
    (tmp_path / "a.scoup.lock").write_bytes(contents)
    with locked_output(tmp_path / "a.scoup"):
        pass
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("contents", ["precious", ""])
def test_a_link_is_no_lock(tmp_path: Path, contents: str) -> None:
    (tmp_path / "target").write_text(contents)
    (tmp_path / "a.scoup.lock").symlink_to("target")
    with pytest.raises(InputError, match="is not a SCOUP lock file"), \
            locked_output(tmp_path / "a.scoup"):  # fmt: skip
        pass
    assert (tmp_path / "target").read_text() == contents
    assert (tmp_path / "a.scoup.lock").is_symlink()
