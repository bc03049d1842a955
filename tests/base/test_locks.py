"""One process at a time writes an output."""

from __future__ import annotations

import json
import os
import pickle
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from scoup.base.atomic import atomic_file
from scoup.base.errors import InputError, OutputExistsError, OutputInUseError
from scoup.base.locks import locked_file, locked_folder
from scoup.base.processes import Processes
from scoup.base.staging import staged

HOLD = """
import sys
from pathlib import Path
from scoup.base.atomic import atomic_path
from scoup.base.locks import locked_file, locked_folder
from scoup.base.staging import staged
path = Path(sys.argv[2])
kinds = {"file": locked_file, "folder": locked_folder, "staged": staged, "nothing": atomic_path}
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


def test_the_second_is_told_who_holds_it(tmp_path: Path) -> None:
    path = tmp_path / "a.scoup"
    with another_process("file", path) as other:
        with pytest.raises(OutputInUseError) as refused, locked_file(path):
            pass
        message = str(refused.value)
        start = f"{path}: is being written by process {other.pid} on {socket.gethostname()} since "
        assert message.startswith(start)
        hour, minute = message.removeprefix(start).partition(";")[0].split(":")
        assert 0 <= int(hour) < 24
        assert 0 <= int(minute) < 60
        assert message.endswith("; wait for it or give another --out")
        assert str(pickle.loads(pickle.dumps(refused.value))) == message
        with locked_file(tmp_path / "b.scoup"):  # another output
            pass
    assert not list(tmp_path.iterdir())  # it was removed by the other at its end
    with locked_file(path):
        assert json.loads((tmp_path / "a.scoup.lock").read_text())["process"] == os.getpid()
    assert not list(tmp_path.iterdir())


def test_the_lock_of_a_dead_process_is_taken_over(tmp_path: Path) -> None:
    path = tmp_path / "a.scoup"
    with another_process("file", path) as other:
        other.kill()
        other.wait()
    assert (tmp_path / "a.scoup.lock").exists()
    with locked_file(path):
        assert json.loads((tmp_path / "a.scoup.lock").read_text())["process"] == os.getpid()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, SystemExit])
def test_it_is_given_up_after_an_error(tmp_path: Path, error: type[BaseException]) -> None:
    def work() -> None:
        with locked_file(tmp_path / "new" / "a.scoup"):
            assert (tmp_path / "new" / "a.scoup.lock").exists()
            raise error

    with pytest.raises(error):
        work()
    assert not list(tmp_path.iterdir())  # nor does the folder stay that was made for it


def test_what_another_process_has_just_finished_is_not_made_again(tmp_path: Path) -> None:
    path = tmp_path / "a.scoup"
    path.write_text("precious")
    with pytest.raises(OutputExistsError), locked_file(path):
        pass
    with locked_file(path, overwrite=True):
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
    with locked_file(path):
        pass
    left = {item.name for item in tmp_path.iterdir()} - set(precious)
    (other_output,) = left
    assert other_output.startswith(".b.")


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


def test_of_several_processes_the_first_holds_it_and_all_are_refused(tmp_path: Path) -> None:
    said = []

    class Others(Processes):
        def from_rank(self, item, rank):
            said.append(item)
            return item

    path = tmp_path / "a.scoup"
    with locked_file(path, processes=Others(1, 2)):
        assert not list(tmp_path.iterdir())  # the second writes no lock
    path.write_text("x")
    with pytest.raises(OutputExistsError), locked_file(path, processes=Others(0, 2)):
        pass
    assert said[0] == (None,)
    assert isinstance(said[1][0], OutputExistsError)  # which every process would raise


def test_a_lock_file_of_other_contents(tmp_path: Path) -> None:
    (tmp_path / "a.scoup.lock").write_text("not JSON")
    with (
        locked_file(tmp_path / "a.scoup"),
        pytest.raises(OutputInUseError),
        locked_file(tmp_path / "a.scoup"),
    ):
        pass
