"""The whole demo, on small scenes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from benchmarks.scenes.yard import YARD

from cli_support import QUICK, refused, run, run_json
from scoup.view import export, viewer
from scoup.view.page import page_files
from scoup_lab.evaluate.demonstration import rows_by_name, run_demo
from scoup_lab.evaluate.demonstration_sheet import query_sheet
from scoup_lab.synthetic import EMBEDDING_MODEL
from view.view_samples import PAGE

TINY = ("--n-gaussians", 2000, "--width", 64, "--height", 48, "--views", 2)
SMALL = ("--n-gaussians", 12000, "--width", 160, "--height", 120, "--views", 6)


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """The folder of a demo, which nobody writes into, and what the command printed."""
    out = tmp_path_factory.mktemp("demonstration") / "demo"
    with pytest.MonkeyPatch.context() as patch:
        for module in (viewer, export):  # whether or not the page is built here
            patch.setattr(module, "page_files", lambda: PAGE)
        return out, run_json("demo", "--out", out, *TINY)


def test_demo_writes_everything(demo: tuple[Path, dict[str, Any]]) -> None:
    out, record = demo
    files = {"scene", "demo.scoup", "queries.png", "scores.json", "demo.html"}
    assert {path.name for path in out.iterdir()} == files
    assert "window.scoupData" in (out / "demo.html").read_text()
    assert json.loads((out / "scores.json").read_text())["names"] == record["names"]
    assert record["layout"] == "table"
    assert "overwrite" in refused("demo", "--out", out, *TINY, folder=out)


def test_the_folder_of_the_demo_can_be_built_and_queried(
    demo: tuple[Path, dict[str, Any]], tmp_path: Path
) -> None:
    scene, field = demo[0] / "scene", tmp_path / "again.scoup"
    assert run("build", scene, *QUICK, "--model", scene / "text.npz", "--out", field)[0] == 0
    for built in (field, demo[0] / "demo.scoup"):  # both find the table by themselves
        found = run_json("query", built, "teapot", "--out", tmp_path / "q", "--overwrite")
        assert found["answers"][0]["text"] == "teapot"
        assert run_json("info", built)["embedding_model"] == EMBEDDING_MODEL


def test_without_its_page_the_demo_says_how_to_get_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("scoup.view.viewer.page_files", lambda: page_files(tmp_path))
    code, printed, err = run("demo", "--out", tmp_path / "demo", *TINY)
    assert (code, err) == (0, "")
    assert not (tmp_path / "demo" / "demo.html").exists()
    assert "tools/build_viewer.py" in printed
    assert "scoup view" in printed


@pytest.mark.slow
def test_demo_finds_things(tmp_path: Path) -> None:
    code, printed, err = run("demo", "--out", tmp_path / "demo", *SMALL)
    assert code == 0, err
    assert "teapot" in printed
    assert "bytes of codes" in printed
    record = json.loads((tmp_path / "demo" / "scores.json").read_text())
    # Chance level is a few per cent; a broken stage brings it there.
    assert record["miou"] > 0.35
    assert record["accuracy"] > 0.6
    assert len(record["names"]) >= 15


@pytest.mark.slow
def test_another_layout_is_queried_for_what_it_shows(tmp_path: Path) -> None:
    result = run_demo(tmp_path, 0, 12000, 160, 120, 6, YARD)
    assert {"fountain", "gnome"} <= {row.name for row in rows_by_name(result)}
    assert query_sheet(result).ndim == 3
    note = (tmp_path / "scene" / "README.txt").read_text()
    assert "garden" in note
    assert '"fountain"' in note
