"""scoup eval scannet on small synthetic data sets, as a user runs it."""

from __future__ import annotations

import json
import shlex
import shutil
from pathlib import Path

import pytest

from cli.test_verb_eval import QUICK
from cli.test_verb_eval import original as original  # the fixture: a version of each data set
from cli_support import refused, run, run_json

pytestmark = pytest.mark.slow


def test_scannet(here: Path) -> None:
    result = run_json("eval", "scannet", "scannet", *QUICK)
    out = here / "eval_scannet"
    assert set(result["reports"]) == {"scannet_19", "scannet_15", "scannet_10"}
    for stem, record in result["reports"].items():
        assert json.loads((out / f"{stem}.json").read_text()) == record
        assert 0.3 < record["systems"]["this run"]["overall"]["mIoU"] < 1
        assert set(record["systems"]["this run"]["scenes"]) == {"table", "shelves"}
        for suffix in ("md", "tex"):
            assert "mAcc" in (out / f"{stem}.{suffix}").read_text()
    assert "--overwrite" in refused("eval", "scannet", "scannet", *QUICK, folder=here)
    code, said, _ = run(
        "eval", "scannet", "scannet", *QUICK, "--classes", "10", "--overwrite", "--level", "m"
    )
    assert code == 0
    assert "10 (10 classes): 2 scenes" in said


def test_scannet_refusals(here: Path) -> None:
    assert "list of classes" in refused("eval", "scannet", "scannet", "--classes", "20")
    assert "labels.ply" in refused("eval", "scannet", "lerf-ovs")
    splat = here / "lerf-ovs" / "shelves" / "point_cloud.ply"
    message = refused("eval", "scannet", "scannet", *QUICK, "--scenes", "table", "--gaussians", splat)
    assert "frozen" in message
    labels = here / "scannet" / "table" / "table_vh_clean_2.labels.ply"
    labels.write_bytes(labels.read_bytes()[:-100])
    assert "cut short" in refused("eval", "scannet", "scannet", *QUICK, "--scenes", "table")


def test_scannet_with_parts_elsewhere(here: Path) -> None:
    scene = here / "scannet" / "table"
    for name in ("sparse", "language_features", "images"):
        shutil.move(scene / name, here / "views" / "table" / name)
    arguments = ("eval", "scannet", "scannet", *QUICK, "--scenes", "table", "--methods", "dense")
    assert "pass features" in refused(*arguments)
    places = [f"--{name}" for name in ("features", "images", "cameras")]
    named = zip(
        places, ("views/{scene}/language_features", "views/{scene}/images", "views/{scene}"), strict=True
    )
    result = run_json(*arguments, *(part for pair in named for part in pair))
    systems = result["reports"]["scannet_10"]["systems"]
    assert systems["this run"]["overall"]["mIoU"] > 0.3
    assert 0.1 < systems["dense"]["overall"]["mIoU"] < 1
    assert systems["dense"]["intervals"]["mIoU"] is None  # of one scene


def test_synthetic(here: Path) -> None:
    size = shlex.split("--scenes 1 --n-gaussians 2000 --width 48 --height 36 --views 2 --labelled 1")
    result = run_json("eval", "synthetic", "scannet", "made", *size)
    assert result["scenes"] == ["table"]
    assert "made" in refused("eval", "synthetic", "scannet", "made", *size)
    assert "scoup eval scannet ." in (here / "made" / "README.txt").read_text()
