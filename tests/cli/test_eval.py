"""scoup eval on small synthetic data sets, as a user runs it."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from PIL import Image

from cli_support import refused, run, run_json
from messages import check_message
from scoup.base import Registry
from scoup_lab.evaluate import protocols
from scoup_lab.evaluate.protocols.lerf_ovs import PROTOCOL
from scoup_lab.evaluate.protocols.pixels import PixelProtocol

pytestmark = pytest.mark.slow

QUICK = ("--n-atoms", 16)
LERF = ("eval", "lerf-ovs", "lerf-ovs", "--scenes", "table")
SCANNET = ("eval", "scannet", "scannet", *QUICK)
STUDY = ("lerf-ovs", "--scenes", "table")


@pytest.fixture(scope="session")
def original(synthetic_data_sets: Path) -> Path:
    """A folder with a synthetic version of each data set; nobody writes into it."""
    return synthetic_data_sets


def test_a_protocol_of_a_package_is_a_verb(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
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
    overall = record["overall"]
    assert 0 < overall["miou_interval"][0] < overall["miou"] < overall["miou_interval"][1] < 1
    assert (overall["accuracy"] is not None) == (name == "lerf-ovs")
    assert json.loads((out / f"{name}_3d-selection.json").read_text())["protocol"] == "3D selection"
    for suffix in ("md", "tex"):
        assert "3D selection" not in (out / f"{name}_scoup.{suffix}").read_text()
    for scene in ("table", "shelves"):
        with Image.open(out / "failures" / f"{scene}_scoup.png") as sheet:
            assert sheet.size[0] == 1200


def test_built_once_scored_by_other_rules(here: Path) -> None:
    def miou(rules: str) -> float:
        record = json.loads((here / "eval_lerf-ovs" / f"lerf-ovs_{rules}.json").read_text())
        return record["overall"]["miou"]

    run_json(*LERF, *QUICK)
    field = here / "eval_lerf-ovs" / "fields" / "table.scoup"
    made = field.stat().st_mtime_ns
    run_json(*LERF, *QUICK, "--rules", "langsplat")
    assert field.stat().st_mtime_ns == made
    first = miou("scoup")
    assert first != miou("langsplat")
    assert "--overwrite" in refused(*LERF, *QUICK)
    run_json(*LERF, *QUICK, "--overwrite")
    assert miou("scoup") == first
    assert "remove the field" in refused(*LERF, "--n-atoms", 8, "--overwrite")


MISTAKES = """3d-ovs 3d-ovs --rules langsplat
lerf-ovs absent
lerf-ovs lerf-ovs --scenes tabel
lerf-ovs lerf-ovs --scenes table --text words.json
baselines lerf-ovs --methods dens
scannet scannet --classes 20
scannet lerf-ovs
scannet scannet --scenes shelves --gaussians lerf-ovs/table/point_cloud.ply
scannet scannet --scenes table""".splitlines()


def test_mistakes_are_one_sentence(here: Path) -> None:
    (here / "lerf-ovs" / "table" / "text.npz").unlink()
    (here / "words.json").write_text('{"object": [1.0, 0.0]}')
    labels = here / "scannet" / "table" / "table_vh_clean_2.labels.ply"
    labels.write_bytes(labels.read_bytes()[:-100])
    for command in MISTAKES:
        check_message(refused("eval", *command.split()))


def test_baselines(here: Path) -> None:
    names = ("sparse", "dense", "centre-pixel", "top-45-contributors")
    chosen = [part for name in names for part in ("--methods", name)]
    compare = ("eval", "baselines", *STUDY, "--selection")
    assert "table, sparse: mIoU " in run(*compare, *chosen[:2])[1]
    record = run_json(*compare, *chosen, "--overwrite")
    assert list(record["methods"]) == list(names)
    assert all(0 < row["miou"] < 1 and row["selection_miou"] for row in record["methods"].values())
    assert "3D selection" in (here / "eval_lerf-ovs" / "baselines.md").read_text()
    assert run(*compare, *chosen, "--overwrite")[1].count(", kept from before") == len(names)


def test_the_default_scores_alike_by_itself_and_beside_others(here: Path) -> None:
    """On images larger than those of the region sums."""
    size = ("--n-gaussians", 3000, "--width", 600, "--height", 400, "--views", 4, "--labelled", 2)
    run_json("eval", "synthetic", "lerf-ovs", "wide", *size, "--scenes", 1, "--seed", 5)
    alone = run_json("eval", "lerf-ovs", "wide", "--selection")["reports"]
    beside = run_json("eval", "baselines", "wide", "--methods", "sparse", "--selection")["methods"]["sparse"]
    score, selected = alone["lerf-ovs_scoup"], alone["lerf-ovs_3d-selection"]
    assert 0 < score["overall"]["miou"] < 1
    for name in ("miou", "miou_interval", "accuracy"):
        assert score["overall"][name] == beside[name]
    assert selected["overall"]["miou"] == beside["selection_miou"]


def test_ablations(here: Path) -> None:
    groups = [part for name in ("vote", "entropy", "levels") for part in ("--groups", name)]
    rows = run_json("eval", "ablations", *STUDY, *groups, "--seeds", 0, 1)["rows"]
    assert "L=32" not in rows
    assert rows["no top-K"]["seeds"] == [0, 1]
    assert "level by mask" in rows


def test_consistency(here: Path) -> None:
    record = run_json("eval", "consistency", *STUDY)
    assert record["matched_by"] == {"table": "Gaussians"}
    assert {row["features"] for row in record["results"]} == {"raw", "autoencoder", "sparse codes"}


def test_synthetic_data_sets(tmp_path: Path) -> None:
    size = ("--n-gaussians", 2000, "--width", 64, "--height", 48, "--views", 2, "--labelled", 1)
    command = ("eval", "synthetic", "lerf-ovs", tmp_path / "lerf-ovs", *size, "--seed", 3)
    assert run_json(*command)["scenes"] == ["table_3", "table_4"]
    assert PROTOCOL.find(tmp_path / "lerf-ovs") == ["table_3", "table_4"]
    assert "--overwrite" in refused(*command, folder=tmp_path / "lerf-ovs")


def test_scannet(here: Path) -> None:
    result = run_json(*SCANNET)
    out = here / "eval_scannet"
    assert set(result["reports"]) == {"scannet_19", "scannet_15", "scannet_10"}
    for stem, record in result["reports"].items():
        assert json.loads((out / f"{stem}.json").read_text()) == record
        assert 0.3 < record["systems"]["this run"]["overall"]["mIoU"] < 1
        assert (out / f"{stem}.tex").is_file()
    assert "--overwrite" in refused(*SCANNET)
    said = run(*SCANNET, "--classes", "10", "--overwrite", "--level", "m")[1]
    assert "10 (10 classes): 2 scenes" in said


def test_scannet_with_parts_elsewhere(here: Path) -> None:
    scene = here / "scannet" / "table"
    for name in ("sparse", "language_features", "images"):
        shutil.move(scene / name, here / "views" / "table" / name)
    arguments = (*SCANNET, "--scenes", "table", "--methods", "dense")
    assert "pass features" in refused(*arguments)
    places = (
        "--features views/{scene}/language_features --images views/{scene}/images --cameras views/{scene}"
    )
    systems = run_json(*arguments, *places.split())["reports"]["scannet_10"]["systems"]
    assert 0.1 < systems["dense"]["overall"]["mIoU"] < 1
    assert systems["dense"]["intervals"]["mIoU"] is None  # of one scene
