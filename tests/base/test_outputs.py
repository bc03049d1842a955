"""Files that get their names together, whatever ends the process meanwhile."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from cli_support import snapshot
from scoup.base.errors import OutputExistsError, ScoupWarning, WriteError
from scoup.base.locks import complete, locked_output

# Writes a.scoup, and makes the folder a.scoup.partial a.scoup.sums, or removes it; killed before the n-th step.
FINISH = """
import os, shutil, signal, sys
from pathlib import Path
from scoup.base.locks import locked_output
path, last = Path("a.scoup"), int(sys.argv[1])
Path("a.scoup.partial").mkdir()
Path("a.scoup.partial/view").write_text("new sums")
def counted(function):
    def step(*arguments, **more):
        steps.append(1)
        if len(steps) == last:
            os.kill(os.getpid(), signal.SIGKILL)
        return function(*arguments, **more)
    return step
steps = []
with locked_output(path, overwrite=True) as output:
    sums = Path("a.scoup.sums") if sys.argv[2] == "keep" else None
    with output.appearing(Path("a.scoup.partial"), sums) as temporary:
        temporary.write_text("new field")
        os.replace, Path.unlink, shutil.rmtree = counted(os.replace), counted(Path.unlink), counted(shutil.rmtree)
print(len(steps))
"""
OLD = {"a.scoup": b"old field", "a.scoup.sums/view": b"old sums"}
NEW = {"a.scoup": b"new field", "a.scoup.sums/view": b"new sums"}
MADE = {"a.scoup.partial/view": b"new sums"}


@pytest.fixture(autouse=True)
def _here(tmp_path: Path) -> Iterator[None]:
    before = Path.cwd()
    os.chdir(tmp_path)
    yield
    os.chdir(before)


def write(files: dict[str, bytes]) -> None:
    for name, content in files.items():
        Path(name).parent.mkdir(exist_ok=True)
        Path(name).write_bytes(content)


def finished(last: int, what: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", FINISH, str(last), what]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    return subprocess.run(command, capture_output=True, text=True, env=environment)


@pytest.mark.parametrize("what", ["keep", "remove"])
@pytest.mark.parametrize("before", [OLD, {}], ids=["old", "none"])
def test_all_or_nothing_wherever_it_is_killed(before: dict[str, bytes], what: str) -> None:
    wanted = NEW if what == "keep" else {**before, "a.scoup": NEW["a.scoup"]}
    write(before)
    done = finished(0, what)
    assert done.returncode == 0, done.stderr
    assert snapshot(Path()) == wanted
    outcomes = set()
    for last in range(1, int(done.stdout) + 1):
        for path in Path().iterdir():
            shutil.rmtree(path) if path.is_dir() else path.unlink()
        write(before)
        assert finished(last, what).returncode == -signal.SIGKILL
        left = snapshot(Path())
        named = {name for name in wanted if left.get(name) == wanted[name]}
        if set(MADE) <= set(left):
            complete(Path("a.scoup"))
            outcomes.add("before")
            assert snapshot(Path()) == {**before, **MADE}
            continue
        if named == set(wanted):
            complete(Path("a.scoup"))
        else:
            with pytest.warns(ScoupWarning, match=r"^a.scoup: completed the renames of a killed process \("):
                complete(Path("a.scoup"))
        outcomes.add("after" if named == set(wanted) else "between")
        assert snapshot(Path()) == wanted
    assert outcomes == {"before", "between", "after"}


def test_the_next_holder_completes_before_it_looks_whether_the_output_is_there() -> None:
    write({".a.scoup.sums.ready": b"sums", ".a.scoup.temporary": b"field", ".a.scoup.rest.unwanted": b"rest"})
    with (
        pytest.warns(ScoupWarning, match=r"\(a.scoup, a.scoup.sums\)"),
        pytest.raises(OutputExistsError),
        locked_output(Path("a.scoup")),
    ):
        pass
    assert snapshot(Path()) == {"a.scoup": b"field", "a.scoup.sums": b"sums"}


def test_a_file_that_was_not_complete_is_removed() -> None:
    write(
        {
            ".a.scoup.temporary": b"half a field",
            "a.scoup.partial": b"sums",
            ".b.scoup.sums.ready": b"another's",
        }
    )
    with locked_output(Path("a.scoup")):
        assert not Path(".a.scoup.temporary").exists()
    assert snapshot(Path()) == {"a.scoup.partial": b"sums", ".b.scoup.sums.ready": b"another's"}


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_nothing_is_left_after_an_error(error: type[BaseException]) -> None:
    def work() -> None:
        with (
            locked_output(Path("a.scoup")) as output,
            output.appearing(Path("a.scoup.partial"), Path("a.scoup.sums")) as temporary,
        ):
            temporary.write_text("field")
            raise error

    write({"a.scoup.partial": b"sums"})
    with pytest.raises(error):
        work()
    assert snapshot(Path()) == {"a.scoup.partial": b"sums"}


def test_files_of_other_outputs_are_a_fault_of_the_program() -> None:
    write({"a.scoup.partial": b"sums"})
    for name in ("b.scoup.sums", "new/a.scoup.sums"):
        with (
            pytest.raises(ValueError, match="does not belong to the output"),
            locked_output(Path("a.scoup")) as output,
            output.appearing(Path("a.scoup.partial"), Path(name)),
        ):
            pass
    assert snapshot(Path()) == {"a.scoup.partial": b"sums"}


def test_nothing_is_completed_while_its_process_lives() -> None:
    with locked_output(Path("a.scoup")):
        write({".a.scoup.sums.ready": b"sums"})
        complete(Path("a.scoup"))
        assert snapshot(Path())[".a.scoup.sums.ready"] == b"sums"
    with pytest.warns(ScoupWarning, match=r"\(a.scoup.sums\)"):
        complete(Path("a.scoup"))  # also where there is no lock
    assert snapshot(Path()) == {"a.scoup.sums": b"sums"}


@pytest.mark.parametrize("refused", [1, 2, 3])
def test_a_refused_rename(refused: int, monkeypatch: pytest.MonkeyPatch) -> None:
    write({**OLD, "a.scoup.partial/view": b"new sums"})
    rename, renamed = os.replace, []

    def refuse(first: Path, second: Path) -> None:
        renamed.append(second)
        if len(renamed) == refused:
            raise PermissionError(13, "Permission denied", str(first))
        rename(first, second)

    def finish() -> None:
        with (
            locked_output(Path("a.scoup"), overwrite=True) as output,
            output.appearing(Path("a.scoup.partial"), Path("a.scoup.sums")) as temporary,
        ):
            temporary.write_bytes(b"new field")
            monkeypatch.setattr(os, "replace", refuse)

    name = ("a.scoup", "a.scoup", "a.scoup.sums")[refused - 1]
    with pytest.raises(WriteError, match=rf"^{name}: cannot be written \(Permission denied\)"):
        finish()
    monkeypatch.undo()
    if refused < 3:  # nothing has changed
        assert snapshot(Path()) == {**OLD, "a.scoup.partial/view": b"new sums"}
        return
    assert snapshot(Path())["a.scoup"] == b"new field"
    with pytest.warns(ScoupWarning, match=r"\(a.scoup.sums\)"):  # the rest, once it is allowed
        complete(Path("a.scoup"))
    assert snapshot(Path()) == NEW
