"""Splats of more rows than are kept in memory."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest

from io_samples import same_gaussians
from scoup.base import ScoupWarning, WriteError
from scoup.io import load_gaussians, read_ply_table, write_ply, write_ply_table
from scoup.io.splats import ply, ply_rows
from support import random_gaussians


@pytest.fixture
def small_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ply, "MOST_ROWS_IN_MEMORY", 10)
    monkeypatch.setattr(ply_rows, "AT_A_TIME", 7)


@pytest.mark.parametrize("count", [11, 14, 50])
def test_the_same_as_in_memory(
    count: int, tmp_path: Path, small_parts: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_ply(random_gaussians(count, seed=0), tmp_path / "a.ply")
    large = load_gaussians(tmp_path / "a.ply")
    monkeypatch.setattr(ply, "MOST_ROWS_IN_MEMORY", 1000)
    assert same_gaussians(large, load_gaussians(tmp_path / "a.ply"))
    assert large.fingerprint() == load_gaussians(tmp_path / "a.ply").fingerprint()


def test_rows_that_are_not_finite_are_dropped_with_one_warning(
    tmp_path: Path, small_parts: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_ply(random_gaussians(40, seed=0), tmp_path / "a.ply")
    table = read_ply_table(tmp_path / "a.ply")
    for row in (0, 13, 39):
        table.rows["x"][row] = np.nan
    write_ply_table(table, tmp_path / "b.ply")
    with pytest.warns(ScoupWarning, match=r"dropped 3 of 40 Gaussians") as found:
        large = load_gaussians(tmp_path / "b.ply")
    assert len(found) == 1
    assert len(large) == 37
    monkeypatch.setattr(ply, "MOST_ROWS_IN_MEMORY", 1000)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ScoupWarning)
        assert same_gaussians(large, load_gaussians(tmp_path / "b.ply"))


def test_no_room_for_temporary_files(
    tmp_path: Path, small_parts: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_ply(random_gaussians(20, seed=0), tmp_path / "a.ply")

    def full(*_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.posix_fallocate", full)
    with pytest.raises(WriteError, match="TMPDIR"):
        load_gaussians(tmp_path / "a.ply")
