"""One process at a time writes an output, and what a killed one leaves goes with the next."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from subprocess import PIPE

import pytest

from children import Child, child, finished
from scoup.base.errors import OutputExistsError, OutputInUseError, WriteError
from scoup.base.outputs import atomic_file, atomic_path, locked, staged

WRITERS: dict[str, Callable[..., AbstractContextManager]] = {
    "file": atomic_file, "path": atomic_path, "staged": staged
}  # fmt: skip
HOLD = """
import sys
from pathlib import Path
from scoup.base.outputs import atomic_file, atomic_path, staged
writer = {"file": atomic_file, "path": atomic_path, "staged": staged}[sys.argv[1]]
with writer(Path(sys.argv[2])) as made:
    if sys.argv[1] == "file":
        made.write(b"half")
    else:
        (made / "half" if sys.argv[1] == "staged" else made).write_text("half")
    print("held", flush=True)
    sys.stdin.read()
"""


@contextmanager
def another_process(what: str, path: Path) -> Iterator[Child]:
    """A process that writes a path until the block ends, or it is killed."""
    command = [sys.executable, "-c", HOLD, what, str(path)]
    with child(command, stdin=PIPE) as process:
        assert process.stdout.readline() == "held\n"
        yield process
        process.communicate()


@pytest.mark.parametrize("what", WRITERS)
def test_the_second_is_refused_and_what_a_killed_one_left_goes_with_the_next(
    tmp_path: Path, what: str
) -> None:
    path, other = tmp_path / "a.scoup", tmp_path / "b.scoup"
    with another_process(what, path) as first, another_process(what, other) as second:
        with pytest.raises(OutputInUseError) as refused, WRITERS[what](path):
            pass
        said = f"{path}: is being written by another process; wait for it, or choose another output"
        assert str(refused.value) == said
        with atomic_file(tmp_path / "c.scoup"):  # another output
            pass
        for process in (first, second):
            process.kill()
            process.wait()
    assert not path.is_file()
    left = {*tmp_path.rglob(".*")}
    assert len(left) == 4  # a temporary and a lock file of each
    with WRITERS[what](path) as made:
        if what == "path":
            made.write_text("whole")
    remaining = {*tmp_path.rglob(".*")}
    assert len(remaining) == 2
    assert remaining < left  # those of the other output


AMID_MOVES = """
import os, sys
from pathlib import Path
from scoup.base.outputs import staged
replace = os.replace
def last(*paths):
    replace(*paths)
    os._exit(9)
os.replace = last
with staged(Path(sys.argv[1]), ["a", "deep/b"]) as hidden:
    (hidden / "deep").mkdir()
    (hidden / "a").touch()
    (hidden / "deep/b").touch()
"""


def test_a_process_that_was_killed_while_files_move_leaves_nothing_for_long(tmp_path: Path) -> None:
    folder = tmp_path / "new" / "folder"
    assert finished([sys.executable, "-c", AMID_MOVES, folder]).returncode == 9
    with staged(folder, ["a"], overwrite=True) as hidden:
        (hidden / "a").touch()
    assert [*tmp_path.rglob("*")] == [folder.parent, folder, folder / "a"]


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, SystemExit])
@pytest.mark.parametrize("what", WRITERS)
def test_nothing_is_left_after_an_error(tmp_path: Path, what: str, error: type[BaseException]) -> None:
    def work() -> None:
        with WRITERS[what](tmp_path / "new" / "a.scoup"):
            raise error

    with pytest.raises(error):
        work()
    assert not [*tmp_path.iterdir()]


def test_what_another_process_has_just_finished_is_not_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.scoup"

    def locked_late(output: Path, wait: bool, kind: str) -> AbstractContextManager[None]:
        path.write_text("precious")  # between the first check and the lock
        return locked(output, wait, kind)

    monkeypatch.setattr("scoup.base.outputs.locked", locked_late)
    with pytest.raises(OutputExistsError), atomic_file(path):
        pass
    assert path.read_text() == "precious"
    assert [item.name for item in tmp_path.iterdir()] == ["a.scoup"]


def test_a_lock_can_be_waited_for(tmp_path: Path) -> None:
    path, order = tmp_path / "a.scoup", []

    def wait() -> None:
        with locked(path, wait=True):
            order.append("second")

    with locked(path):
        thread = threading.Thread(target=wait)
        thread.start()
        order.append("first")
    thread.join()
    assert order == ["first", "second"]
    assert not list(tmp_path.iterdir())


def test_a_lock_that_the_system_refuses(tmp_path: Path) -> None:
    (tmp_path / ".a.scoup.lock").mkdir()
    with pytest.raises(WriteError, match=r"a\.scoup: cannot be written"), locked(tmp_path / "a.scoup"):
        pass


def test_files_of_users_with_names_like_ours_stay(tmp_path: Path) -> None:
    precious = [".a.scoup", ".a.backup.scoup", "a.partial", ".ab.scoup.partial", ".a.scoup.partial.txt"]
    for name in precious:
        (tmp_path / name).write_text("x")
    with atomic_file(tmp_path / "a.scoup"):
        pass
    assert {item.name for item in tmp_path.iterdir()} == {*precious, "a.scoup"}


def test_two_processes_stage_different_files_into_one_folder(tmp_path: Path) -> None:
    with staged(tmp_path, ["a"]) as first, staged(tmp_path, ["b"]) as second:
        (first / "a").write_text("a")
        (second / "b").write_text("b")
        with pytest.raises(OutputInUseError) as refused, staged(tmp_path, ["a"]):
            pass
    assert refused.value.path == tmp_path / "a"
    assert sorted(item.name for item in tmp_path.iterdir()) == ["a", "b"]
