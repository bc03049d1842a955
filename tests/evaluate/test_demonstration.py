"""The whole demo, on a small scene."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from benchmarks.scenes.yard import YARD

from cli_support import run
from scoup.evaluate.demonstration import DemoSettings, rows_by_name, run_demo
from scoup.evaluate.demonstration_sheet import query_sheet

SMALL = ("--n-gaussians", 12000, "--width", 160, "--height", 120, "--views", 6)


@pytest.mark.slow
def test_demo_writes_everything_and_finds_things(tmp_path: Path) -> None:
    out = tmp_path / "demo"
    code, printed, err = run("demo", "--out", out, *SMALL, "--json")
    assert code == 0, err
    record = json.loads(printed)
    assert {path.name for path in out.iterdir()} == {"scene", "demo.scoup", "queries.png", "scores.json"}
    assert json.loads((out / "scores.json").read_text())["methods"] == record["methods"]
    method = record["methods"]["sparse, top-K vote"]
    # Chance level is a few per cent; a broken stage brings it there.
    assert method["miou"] > 0.35
    assert method["accuracy"] > 0.6
    assert set(record["methods"]) == {"sparse, top-K vote", "sparse, no top-K", "dense 512-d"}
    assert len(record["names"]) >= 15
    before = (out / "demo.scoup").read_bytes()
    code, _, err = run("demo", "--out", out, *SMALL)
    assert code == 2
    assert "overwrite" in err
    assert (out / "demo.scoup").read_bytes() == before


@pytest.mark.slow
def test_the_folder_of_the_demo_can_be_built_and_queried_from_the_command_line(tmp_path: Path) -> None:
    out = tmp_path / "demo"
    assert run("demo", "--out", out, *SMALL)[0] == 0
    scene, field = out / "scene", tmp_path / "again.scoup"
    assert run("build", scene, "--out", field)[0] == 0
    code, printed, err = run(
        "query", field, "teapot", "--text", scene / "text.npz", "--out", tmp_path / "q", "--json"
    )
    assert code == 0, err
    assert json.loads(printed)["answers"][0]["text"] == "teapot"


@pytest.mark.slow
def test_another_layout_is_queried_for_what_it_shows(tmp_path: Path) -> None:
    size = DemoSettings(n_gaussians=12000, width=160, height=120, n_building=6, layout=YARD)
    result = run_demo(tmp_path, size)
    assert {"fountain", "gnome"} <= {row.name for row in rows_by_name(result)}
    assert query_sheet(result).ndim == 3
    note = (tmp_path / "scene" / "README.txt").read_text()
    assert "garden" in note
    assert '"fountain"' in note
