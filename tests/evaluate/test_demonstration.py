"""The whole demo, small."""

from __future__ import annotations

import json

import pytest

from cli_support import run
from scoup.base.errors import OutputExistsError

SMALL = ("--n-gaussians", 12000, "--width", 160, "--height", 120, "--views", 6)


@pytest.mark.slow
def test_demo_writes_everything_and_finds_things(tmp_path):
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
    assert OutputExistsError(out).args


@pytest.mark.slow
def test_the_demos_folder_can_be_built_and_asked_from_the_command_line(tmp_path):
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
def test_another_layout_is_asked_for_what_it_holds(tmp_path):
    out = tmp_path / "demo"
    code, printed, err = run("demo", "--layout", "yard", "--out", out, *SMALL, "--json")
    assert code == 0, err
    record = json.loads(printed)
    assert record["layout"] == "yard"
    assert {"fountain", "gnome"} <= {row["name"] for row in record["names"]}
    note = (out / "scene" / "README.txt").read_text()
    assert "garden" in note
    assert '"fountain"' in note


def test_a_wrong_layout_is_told_before_anything_is_made(tmp_path):
    code, _, err = run("demo", "--layout", "yrd", "--out", tmp_path / "demo", *SMALL)
    assert code == 2
    assert "yard" in err
    assert not (tmp_path / "demo").exists()
