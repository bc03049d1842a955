"""Outputs of one process: what may be written, and what appears."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from messages import refuses
from scoup.base.errors import OutputExistsError, WriteError
from scoup.base.outputs import atomic_file, atomic_path, check_output, write_text
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
