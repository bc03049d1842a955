"""scoup bench."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch

from cli_support import refused, run, run_json
from scoup import raster
from scoup_lab.bench import STAGES

TINY = ("bench", "--n-gaussians", "120", "--width", "24", "--height", "16", "--repeats", "1")


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def only_reference(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(raster, "BACKENDS", {"reference": raster.BACKENDS["reference"]})


def test_the_table():
    code, out, err = run(*TINY, "--backends", "reference")
    assert (code, err) == (0, "")
    table = [line for line in out.splitlines() if line.startswith("|")]
    assert [line.split("|")[3].strip() for line in table[2:]] == list(STAGES)
    assert "24 x 16" in out
    assert "only reference was measured" in out


@pytest.mark.usefixtures("only_reference")
def test_where_only_the_reference_exists():
    record = run_json(*TINY, "--stages", "project")
    assert (record["backends"], record["ratios"]) == (["reference"], [])
    assert "only reference was measured" in run(*TINY, "--stages", "project")[1]


def test_backends_that_do_not_work_are_named(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(raster.BACKENDS, "broken", "scoup.raster.no_such_module")
    code, out, _ = run(*TINY, "--stages", "project")
    assert code == 0
    assert "backend broken does not work here: No module named" in out
    assert list(run_json(*TINY, "--stages", "project")["backends_not_working"]) == ["broken"]
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
    assert "other/reference, 1 thread" in run(*TINY, "--stages", "project", "--threads", "1")[1]


def test_quick_is_smaller():
    record = run_json(*TINY, "--stages", "project", "--quick")
    assert (record["rows"][0]["gaussians"], record["width"], record["height"]) == (12, 8, 5)


def test_quiet_prints_nothing():
    assert run(*TINY, "--stages", "project", "--quiet") == (0, "", "")


def test_a_file_is_not_replaced_unasked():
    Path("b.json").write_text("mine")
    message = refused(*TINY, "--stages", "project", "--out", "b.json")
    assert message.startswith("b.json: already exists; pass --overwrite")
    assert run(*TINY, "--stages", "project", "--out", "b.json", "--overwrite")[0] == 0
    assert json.loads(Path("b.json").read_text())["rows"]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--stages", "paint"), "no stage named 'paint'; nearest names: "),
        (("--backends", "nonsense"), "no raster backend named 'nonsense'"),
        (("--n-gaussians", "0"), "--n-gaussians must be 1 or more, got 0"),
        (("--n-gaussians", "5", "-1"), "--n-gaussians must be 1 or more, got -1"),
        (("--n-gaussians",), "--n-gaussians: expected at least one number"),
        (("--width", "0"), "--width must be 1 or more, got 0"),
        (("--height", "-3"), "--height must be 1 or more, got -3"),
        (("--threads", "0"), "--threads must be 1 or more, got 0"),
        (("--repeats", "0"), "--repeats must be 1 or more, got 0"),
        (("--out", "."), "is a folder"),
        (("--device", "toaster"), "--device toaster"),
    ],
)
def test_bad_input(arguments, said):
    assert said in refused(*TINY, *arguments)
