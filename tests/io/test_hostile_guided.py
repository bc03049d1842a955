"""Damaged files that are chosen by the code they reach: readers stand them, and one that misbehaves is found."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest
from benchmarks.hostile.study import Guided
from benchmarks.study import run

pytest.importorskip("atheris", reason="needs atheris")


@pytest.fixture(autouse=True)
def path_of_children(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(path for path in sys.path if path))


def test_a_reader_stands_them_and_more_code_is_reached(tmp_path: Path) -> None:
    record = run(Guided(runs=400, readers=("words.json",), corpus=tmp_path / "corpus"), "guided")
    (found,) = record["readers"]
    assert record["failures"] == 0, found["said"]
    assert found["runs"] == 400
    assert found["reached"] > found["reached_at_first"] > 0
    assert list((tmp_path / "corpus" / "words_json").iterdir())


@pytest.mark.parametrize("reader", ["ValueError", "nameless"])
def test_a_reader_that_misbehaves_is_found(reader: str, tmp_path: Path) -> None:
    table = "planted_readers:PLANTED"
    record = run(
        Guided(runs=400, readers=(reader,), reader_table=table, failures=tmp_path / "failures"), "guided"
    )
    assert record["failures"] == 1
    assert list((tmp_path / "failures" / reader).glob("crash-*"))
