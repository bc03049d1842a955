"""scoup bench."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch

from cli_support import printed, refused, run, run_json
from scoup import raster
from scoup_lab.bench import STAGES

TINY = ("bench", "--n-gaussians", "120", "--width", "24", "--height", "16", "--repeats", "1")


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_the_table():
    out = printed(*TINY, "--backends", "reference")
    table = [line for line in out.splitlines() if line.startswith("|")]
    assert [line.split("|")[2].strip() for line in table[2:]] == list(STAGES)
    assert "24 x 16" in out
    assert "only reference was measured" in out


def test_backends_that_do_not_work_are_named(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(
        raster, "BACKENDS", {"reference": raster.BACKENDS["reference"], "broken": "scoup.none"}
    )
    out = run(*TINY, "--stages", "project")[1]
    assert "backend broken does not work here: No module named" in out
    assert "only reference was measured" in out
    record = run_json(*TINY, "--stages", "project")
    assert (record["backends"], record["ratios"]) == (["reference"], [])
    assert list(record["backends_not_working"]) == ["broken"]
    assert "backend 'broken' does not work here" in refused(*TINY, "--backends", "broken")


def test_json_and_the_file_hold_the_same():
    before = torch.get_num_threads()
    arguments = (*TINY[:2], "120", "60", *TINY[3:], "--threads", "1", "2", "--stages", "project", "vote")
    record = run_json(*arguments, "--out", "new/b.json")
    written = json.loads(Path("new/b.json").read_text())
    assert record == {**written, "out": "new/b.json"}
    assert {row["threads"] for row in written["rows"]} == {1, 2}
    of_reference = [row for row in written["rows"] if row["backend"] == "reference"]
    assert {(row["gaussians"], row["stage"]) for row in of_reference} == {
        (120, "project"), (120, "vote"), (60, "project"), (60, "vote"),
    }  # fmt: skip
    assert all(row["median_s"] > 0 and row["repeats"] == 1 for row in written["rows"])
    assert {"cpu", "cores", "torch", "commit", "native_instruction_set"} <= set(written["machine"])
    assert torch.get_num_threads() == before


def test_a_backend_is_compared_with_the_reference(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(
        raster, "BACKENDS", {"other": raster.BACKENDS["reference"], "reference": raster.BACKENDS["reference"]}
    )
    record = run_json(*TINY, "--stages", "project", "--threads", "1")
    assert [row["backend"] for row in record["rows"]] == ["other", "reference"]
    other, reference = (row["median_s"] for row in record["rows"])
    assert record["ratios"][0]["time_over_reference"] == pytest.approx(other / reference)
    assert "time over reference" in run(*TINY, "--stages", "project", "--threads", "1")[1]
