"""scoup eval scannet, scenesplat, ref-lerf on small synthetic data sets, as a user runs them."""

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


def test_scenesplat(here: Path) -> None:
    chosen = ("--classes", "scannet20", "--classes", "scannet200", "--methods", "dense", "--scenes", "table")
    result = run_json("eval", "scenesplat", "scenesplat", *QUICK, *chosen)
    assert set(result["reports"]) == {"scenesplat_scannet20", "scenesplat_scannet200"}
    for record in result["reports"].values():
        for system in ("this run", "dense"):
            assert 0.1 < record["systems"][system]["overall"]["f-mIoU"] < 1
            assert record["systems"][system]["intervals"]["f-mIoU"] is None  # of one scene
    assert "pass the classes of the benchmark" in refused(
        "eval", "scenesplat", "scenesplat", *QUICK, "--classes", "matterport"
    )


def test_scenesplat_with_parts_elsewhere(here: Path) -> None:
    scene = here / "scenesplat" / "val" / "table"
    for name in ("sparse", "language_features", "images"):
        shutil.move(scene / name, here / "views" / "table" / name)
    arguments = ("eval", "scenesplat", "scenesplat", *QUICK, "--scenes", "table")
    assert "pass features" in refused(*arguments)
    places = [f"--{name}" for name in ("features", "images", "cameras")]
    named = zip(
        places, ("views/{scene}/language_features", "views/{scene}/images", "views/{scene}"), strict=True
    )
    result = run_json(*arguments, *(part for pair in named for part in pair))
    assert result["reports"]["scenesplat_scannet20"]["systems"]["this run"]["overall"]["f-mIoU"] > 0.3


def test_ref_lerf(here: Path) -> None:
    result = run_json("eval", "ref-lerf", "ref-lerf", *QUICK)
    record = result["reports"]["ref-lerf_scoup"]
    assert record["protocol"] == "ref-lerf 2D"
    assert 0.05 < record["overall"]["miou"] < 1
    assert record["overall"]["accuracy"] is None
    queries = {query["query"] for query in record["scenes"]["table"]["queries"]}
    assert any(" next to the " in query for query in queries)
    assert (here / "eval_ref-lerf" / "failures" / "table_scoup.png").is_file()


def test_sentences_of_ref_lerf_are_read_as_phrases(here: Path) -> None:
    """Things answer them, left and right as seen from the frame, in a table of its own."""
    result = run_json("eval", "ref-lerf", "ref-lerf", *QUICK, "--scenes", "table")
    record = result["reports"]["ref-lerf_things"]
    assert record["protocol"] == "ref-lerf by things"
    assert set(record["relations"]) == {"no relation", "near", "left of", "right of"}
    count = sum(row["sentences"] for row in record["relations"].values())
    assert count == record["overall"]["pairs"] == result["reports"]["ref-lerf_scoup"]["overall"]["pairs"]
    assert 0.2 < record["relations"]["no relation"]["things"] < 1
    assert "by relation" in (here / "eval_ref-lerf" / "ref-lerf_things.md").read_text()


def test_methods_are_compared_on_ref_lerf(here: Path) -> None:
    record = run_json(
        "eval", "baselines", "ref-lerf", "--data-set", "ref-lerf", "--scenes", "table", "--methods", "dense"
    )
    assert 0 < record["methods"]["dense"]["miou"] < 1


@pytest.mark.parametrize("name", ["scannet", "scenesplat", "ref-lerf"])
def test_synthetic(here: Path, name: str) -> None:
    size = shlex.split("--scenes 1 --n-gaussians 2000 --width 48 --height 36 --views 2 --labelled 1")
    result = run_json("eval", "synthetic", name, "made", *size)
    assert result["scenes"] == ["table"]
    assert "made" in refused("eval", "synthetic", name, "made", *size)
    assert f"scoup eval {name} ." in (here / "made" / "README.txt").read_text()
