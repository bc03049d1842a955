"""Outputs of one process: what may be written, and what appears, wherever the process is killed or a disk refuses.

So it is after a power cut: files are on the disk before they get their names, and the names after that.
"""

from __future__ import annotations

import os
import shutil
import signal
import stat
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from children import forked
from cli_support import snapshot
from messages import refuses
from scoup.base.errors import OutputExistsError, WriteError
from scoup.base.outputs import atomic_file, atomic_path, check_output, staged, write_text
from scoup.base.scratch import scratch_array


def test_makes_the_folder_and_replaces_nothing_by_default(tmp_path):
    target = tmp_path / "new" / "deeper" / "file.txt"
    write_text(target, "old")
    with refuses(OutputExistsError):
        write_text(target, "new")
    assert target.read_text() == "old"
    write_text(target, "new", overwrite=True)
    assert target.read_text() == "new"
    assert [item.name for item in target.parent.iterdir()] == ["file.txt"]
    (tmp_path / "plain").write_text("x")
    assert target.stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_somebody_else_wrote_meanwhile(tmp_path):
    target = tmp_path / "file.bin"

    with refuses(OutputExistsError), atomic_file(target) as stream:
        stream.write(b"mine")
        target.write_bytes(b"theirs")
    assert target.read_bytes() == b"theirs"
    assert list(tmp_path.iterdir()) == [target]


def test_temporary_path_keeps_the_name(tmp_path):
    with atomic_path(tmp_path / "picture.png") as temporary:
        assert temporary.name == "picture.png"
        assert temporary.parent.parent == tmp_path
        (temporary.parent / "of a library").write_bytes(b"half")
        temporary.write_bytes(b"x")
    assert [item.name for item in tmp_path.iterdir()] == ["picture.png"]
    assert (tmp_path / "picture.png").read_bytes() == b"x"


def test_folders_and_special_files_are_no_outputs(tmp_path):
    (tmp_path / "folder").mkdir()
    (tmp_path / "link").symlink_to("folder")
    (tmp_path / "file").write_text("x")
    for path in (tmp_path, "/dev/null", tmp_path / "file" / "below.txt", tmp_path / "link"):
        with refuses():
            check_output(path, overwrite=True)
    with refuses():
        check_output(tmp_path / "link")
    check_output(tmp_path / "missing" / "is fine.txt")
    assert not (tmp_path / "missing").exists()


def test_names_as_long_as_a_file_system_allows(tmp_path):
    for length in (246, 255):
        with atomic_file(tmp_path / ("a" * length)) as stream:
            stream.write(b"whole")
    with atomic_path(tmp_path / ("b" * 255)) as path:
        path.write_text("whole")
    said = r"/a{256}: cannot be written \(File name too long\); choose a shorter name$"
    with pytest.raises(WriteError, match=said), atomic_file(tmp_path / ("a" * 256)):
        pass
    assert sorted(len(path.name) for path in tmp_path.iterdir()) == [246, 255, 255]


# ---- killed, flushed, refused


STEPS = (
    (os, "replace"), (os, "fsync"), (Path, "mkdir"), (Path, "unlink"), (Path, "open"), (shutil, "rmtree"),
)  # fmt: skip


def replace_output(writer: str, last: int) -> int:
    """Replace a.scoup in this process, which is killed before the step of a number; how many steps there are."""
    steps = []

    def counted(function: Callable[..., Any]) -> Callable[..., Any]:
        def step(*arguments: Any, **more: Any) -> Any:
            steps.append(1)
            if len(steps) == last:
                os.kill(os.getpid(), signal.SIGKILL)
            return function(*arguments, **more)

        return step

    for module, name in STEPS:
        setattr(module, name, counted(getattr(module, name)))
    if writer == "file":
        with atomic_file("a.scoup", overwrite=True) as stream:
            stream.write(b"new")
    else:
        with atomic_path("a.scoup", overwrite=True) as path:
            path.write_bytes(b"new")
    return len(steps)


def replaced(writer: str, last: int) -> int:
    """``replace_output`` in a process of its own: its number of steps, or the signal that has ended it, negative."""
    return forked(lambda: replace_output(writer, last))


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
@pytest.mark.parametrize("writer", ["file", "path"])
def test_killed_at_any_step(writer: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    count = replaced(writer, 0)
    assert 3 < count < 255
    outcomes = set()
    for last in range(1, count + 1):
        Path("a.scoup").write_bytes(b"old")
        assert replaced(writer, last) == -signal.SIGKILL
        outcomes.add(Path("a.scoup").read_bytes())
        assert replaced(writer, 0) == count
        assert snapshot(tmp_path) == {"a.scoup": b"new"}
    assert outcomes == {b"old", b"new"}


def test_what_is_written_is_flushed_before_it_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    rename, events = os.replace, []

    def flush(descriptor: int) -> None:
        found = os.fstat(descriptor)
        events.append("folder" if stat.S_ISDIR(found.st_mode) else f"{found.st_size} bytes")

    def renamed(source: Path, target: Path) -> None:
        events.append(f"rename {Path(target).name}")
        rename(source, target)

    monkeypatch.setattr(os, "fsync", flush)
    monkeypatch.setattr(os, "replace", renamed)
    with atomic_file("new/a") as stream:
        assert events == ["folder"]  # that "new" is in
        stream.write(b"12")
    with atomic_path("a") as path:
        path.write_text("12")
    assert events[1:] == 2 * ["2 bytes", "rename a", "folder"]
    events.clear()
    with staged(tmp_path / "new", ["a", "b"], overwrite=True) as hidden:
        (hidden / "a").write_text("1")
        (hidden / "b").write_text("12")
    assert events == ["1 bytes", "2 bytes", "rename a", "rename b", "folder"]


@pytest.mark.parametrize("write", [atomic_file, atomic_path])
def test_a_disk_that_refuses(write: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(_: int) -> None:
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(os, "fsync", refuse)
    said = rf"^{tmp_path}/a: cannot be written \(Input/output error\)"
    with pytest.raises(WriteError, match=said), write(tmp_path / "a") as target:
        target.write_text("x") if isinstance(target, Path) else target.write(b"x")
    assert not list(tmp_path.iterdir())


# ---- large arrays in temporary files


def test_scratch_arrays_are_zeros_that_can_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    array = scratch_array((1000, 3), np.float32)
    assert not array.any()
    array[:] = np.arange(3000).reshape(1000, 3)
    tensor = torch.from_numpy(array)
    del array
    assert torch.equal(tensor, torch.arange(3000, dtype=torch.float32).reshape(1000, 3))
    assert not list(tmp_path.iterdir())  # they have no name
    assert scratch_array((0, 3), np.float32).shape == (0, 3)


def test_scratch_arrays_without_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "gone"))
    with pytest.raises(WriteError, match=r"gone.*TMPDIR"):
        scratch_array((1,), np.float32)
