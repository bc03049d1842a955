"""scoup eval on small synthetic data sets, as a user runs it."""

from __future__ import annotations

import json
import shlex
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from PIL import Image

from cli_support import refused, run, run_json
from scoup.base.registry import Registry
from scoup_lab.data.labels import read_labels
from scoup_lab.evaluate import protocols
from scoup_lab.evaluate.protocols.lerf_ovs import PROTOCOL
from scoup_lab.evaluate.protocols.pixels import PixelProtocol

pytestmark = pytest.mark.slow

QUICK = ("--n-atoms", 16)


@pytest.fixture(scope="session")
def original(synthetic_data_sets: Path) -> Path:
    """A folder with a synthetic version of each data set; nobody writes into it."""
    return synthetic_data_sets


def test_a_protocol_of_a_package_is_a_verb(monkeypatch: pytest.MonkeyPatch) -> None:
    own = replace(PROTOCOL, name="own", help="Score scenes of our own.")
    monkeypatch.setattr(protocols, "PIXELS", Registry("protocol", "none", PixelProtocol, [own]))
    assert "Score scenes of our own." in run("eval", "own", "--help")[1]
    assert "no such folder" in refused("eval", "own", "absent")
    assert "no-such" in run("eval", "no-such", "absent")[2]


@pytest.mark.parametrize("name", ["lerf-ovs", "3d-ovs", "mipnerf360"])
def test_tables_and_sheets(here: Path, name: str) -> None:
    result = run_json("eval", name, name, *QUICK, "--selection")
    out = here / f"eval_{name}"
    record = json.loads((out / f"{name}_scoup.json").read_text())
    assert result["reports"][f"{name}_scoup"] == record
    assert record["protocol"] == f"{name} 2D"
    assert set(record["scenes"]) == {"table", "shelves"}
    assert 0 < record["overall"]["miou"] < 1
    low, high = record["overall"]["miou_interval"]
    assert low < record["overall"]["miou"] < high
    assert (record["overall"]["accuracy"] is not None) == (name == "lerf-ovs")
    mean = sum(scene["miou"] for scene in record["scenes"].values()) / 2
    assert record["overall"]["miou"] == pytest.approx(mean)
    assert record["published_percent"] == []
    selected = json.loads((out / f"{name}_3d-selection.json").read_text())
    assert selected["protocol"] == "3D selection"
    for suffix in ("md", "tex"):
        text = (out / f"{name}_scoup.{suffix}").read_text()
        assert "measured" in text
        assert "3D selection" not in text
    for scene in ("table", "shelves"):
        with Image.open(out / "failures" / f"{scene}_scoup.png") as sheet:
            assert sheet.size[0] == 1200
    if name == "lerf-ovs":
        pairs = sum(
            len(frame.labels)
            for s in ("table", "shelves")
            for frame in read_labels(here / name / "label" / s)
        )
        assert record["overall"]["pairs"] == pairs


def test_predicted_once_scored_by_other_rules(here: Path) -> None:
    run_json("eval", "lerf-ovs", "lerf-ovs", *QUICK, "--scenes", "table", "--sheets", "none")
    maps = {
        path: path.stat().st_mtime_ns for path in (here / "eval_lerf-ovs" / "cache").rglob("*.safetensors")
    }
    field = here / "eval_lerf-ovs" / "fields" / "table.scoup"
    built = field.stat().st_mtime_ns
    assert len(maps) == 2
    run_json(
        "eval", "lerf-ovs", "lerf-ovs", *QUICK, *shlex.split("--scenes table --sheets none --rules langsplat")
    )
    assert {path: path.stat().st_mtime_ns for path in maps} == maps
    assert field.stat().st_mtime_ns == built
    both = [
        json.loads((here / "eval_lerf-ovs" / f"lerf-ovs_{rules}.json").read_text())["overall"]["miou"]
        for rules in ("scoup", "langsplat")
    ]
    assert both[0] != both[1]
    # The same again gives the same, and is refused without --overwrite.
    message = refused("eval", "lerf-ovs", "lerf-ovs", *QUICK, "--scenes", "table", folder=here)
    assert "--overwrite" in message
    again = run_json(
        "eval", "lerf-ovs", "lerf-ovs", *QUICK, "--scenes", "table", "--sheets", "none", "--overwrite"
    )
    assert again["reports"]["lerf-ovs_scoup"]["overall"]["miou"] == both[0]
    message = refused("eval", "lerf-ovs", "lerf-ovs", "--n-atoms", 8, "--scenes", "table", "--overwrite")
    assert "rebuild the fields" in message
    run_json(
        "eval", "lerf-ovs", "lerf-ovs", "--n-atoms", 8, "--scenes", "table", "--overwrite", "--rebuild",
        "--sheets", "none",
    )  # fmt: skip
    assert len(list((here / "eval_lerf-ovs" / "cache").rglob("*.safetensors"))) == 4


def test_published_rows_stand_beside_scenes_of_the_published_names(here: Path) -> None:
    root = here / "named"
    shutil.copytree(here / "lerf-ovs" / "table", root / "ramen")
    shutil.copytree(here / "lerf-ovs" / "label" / "table", root / "label" / "ramen")
    record = run_json("eval", "lerf-ovs", root, *QUICK, "--sheets", "none")["reports"]["lerf-ovs_scoup"]
    assert record["published_percent"][0]["miou"] == 64.4
    text = (here / "eval_lerf-ovs" / "lerf-ovs_scoup.md").read_text()
    assert "| SCOUP (paper) | published | 64.4 |" in text


def test_refusals(here: Path) -> None:
    assert "langsplat" in refused("eval", "3d-ovs", "3d-ovs", "--rules", "langsplat")
    assert "no such folder" in refused("eval", "lerf-ovs", "absent")
    assert "tabel" in refused("eval", "lerf-ovs", "lerf-ovs", "--scenes", "tabel")
    (here / "lerf-ovs" / "table" / "text.npz").unlink()
    (here / "words.json").write_text('{"object": [1.0, 0.0]}')
    message = refused("eval", "lerf-ovs", "lerf-ovs", "--scenes", "table", "--text", "words.json")
    assert "has no vector for" in message
    assert "unknown" not in refused("eval", "baselines", "lerf-ovs", "--methods", "dens")


def test_baselines(here: Path) -> None:
    names = ("sparse", "dense", "centre-pixel", "top-45-contributors")
    chosen = [part for name in names for part in ("--methods", name)]
    compare = ("eval", "baselines", "lerf-ovs", "--scenes", "table", "--selection")
    assert "table, sparse: mIoU " in run(*compare, *chosen[:2])[1]
    record = run_json(*compare, *chosen, "--overwrite")
    assert list(record["methods"]) == list(names)
    for name, row in record["methods"].items():
        assert 0 < row["miou"] < 1
        assert row["query_seconds"] > 0
        assert row["selection_miou"] is not None
        assert len(record["follows"][name]) == 3
    assert record["methods"]["dense"]["bytes_per_gaussian"] == 3 * 512 * 4
    text = (here / "eval_lerf-ovs" / "baselines.md").read_text()
    assert "sparse - dense" in text
    assert "3D selection" in text
    out = run(*compare, *chosen, "--overwrite")[1]
    assert out.count(", kept from before") == len(names)


def test_ablations(here: Path) -> None:
    record = run_json(
        "eval", "ablations", "lerf-ovs", "--scenes", "table", "--groups", "vote", "--groups", "entropy",
        "--groups", "views", "--groups", "levels", "--seeds", 0, 1,
    )  # fmt: skip
    rows = record["rows"]
    assert "L=32" not in rows
    assert rows["dense uplift"]["seeds"] == [0]
    assert rows["no top-K"]["seeds"] == [0, 1]
    assert "level by mask" in rows
    assert rows["1/8 of the views"]["miou"] < rows["base: L=64, K=4, top-K"]["miou"]
    assert (here / "eval_lerf-ovs" / "ablations.png").is_file()


def test_consistency(here: Path) -> None:
    record = run_json("eval", "consistency", "lerf-ovs", "--scenes", "table", "--epochs", 2)
    assert record["matched_by"] == {"table": "Gaussians"}
    assert {row["features"] for row in record["results"]} == {"raw", "autoencoder", "sparse codes"}
    for row in record["results"]:
        assert row["unmatched"] <= row["cosine"] + 0.02
        assert row["points"] > 10


def test_fields_of_an_evaluation_are_asked(here: Path) -> None:
    run_json("eval", "lerf-ovs", "lerf-ovs", *QUICK, "--scenes", "table", "--sheets", "none")
    field = here / "eval_lerf-ovs" / "fields" / "table.scoup"
    words = ("table", "elephant", "piano", "tent", "violin")
    ask = ("query", field, *words, "--overwrite", "--out", "q", "--pictures", "none")
    always = {place["text"]: place for place in run_json(*ask, "--always")["places"]}
    assert all(place["present"] and place["gaussians"] for place in always.values())
    table, *absent = (always[word]["score"] for word in words)
    assert table > max(absent)
    bound = (table + max(absent)) / 2
    for answer in run_json(*ask, "--presence", bound)["answers"]:
        present = answer["text"] == "table"
        assert (answer["present"], answer["score"]) == (present, always[answer["text"]]["score"])
        if not present:
            assert (answer["box"], answer["pixel"], answer["coverage"]) == (None, None, 0)
    assert run("select", field, "table", "--presence", bound, "--out", "s.ply")[0] == 0
    code, _, err = run("select", field, "elephant", "--presence", bound, "--out", "e.ply")
    assert code == 2
    assert "elephant: not in this scene (score 0." in err
    assert run_json(*ask)["answers"][0]["present"], "the table fills the view"
    assert run("select", field, "elephant", "--always", "--out", "e.ply")[0] == 0


def test_synthetic_data_sets(tmp_path: Path) -> None:
    size = ("--n-gaussians", 2000, "--width", 64, "--height", 48, "--views", 2, "--labelled", 1)
    command = ("eval", "synthetic", "lerf-ovs", tmp_path / "lerf-ovs", *size)
    code, out, err = run(*command, "--seed", 3, "--json")
    assert code == 0, err
    assert json.loads(out)["scenes"] == ["table_3", "table_4"]
    assert PROTOCOL.find(tmp_path / "lerf-ovs") == ["table_3", "table_4"]
    assert "--overwrite" in refused(*command, "--seed", 3, folder=tmp_path / "lerf-ovs")
