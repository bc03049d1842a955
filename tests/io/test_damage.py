"""Damaged files of every format are refused, each in the words of the snapshot."""

from __future__ import annotations

from pathlib import Path

import checkpoint_damages
import pytest
import scene_damages
import splat_damages

from messages import refuses
from scoup.base import FileFormatError, MissingFileError

KINDS = splat_damages.KINDS | checkpoint_damages.KINDS | scene_damages.KINDS
CASES = [(name, damage) for name, kind in KINDS.items() for damage in kind.damages]


@pytest.mark.parametrize(("kind", "damage"), CASES)
def test_damaged_files_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str, damage: str
) -> None:
    path = KINDS[kind].make(tmp_path, KINDS[kind].damages[damage])
    with refuses(FileFormatError) as error:
        KINDS[kind].read(path)
    assert isinstance(error.value, FileFormatError)
    assert error.value.remedy
    assert "\n" not in str(error.value)
    assert not capsys.readouterr().out  # nothing in the file was run


@pytest.mark.parametrize("kind", KINDS)
def test_missing_files_are_named(tmp_path: Path, kind: str) -> None:
    with refuses(MissingFileError):
        KINDS[kind].read(tmp_path / "none")
