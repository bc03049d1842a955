"""scoup info, on every kind of file."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from cli_support import refused, run, run_json
from scoup.io import load_cameras, load_gaussians, save_gaussians, write_inria_cameras, write_transforms

pytestmark = pytest.mark.usefixtures("here")


def test_a_field():
    record = run_json("info", "f.scoup")
    expected = {
        "kind": "language field",
        "gaussians": 150,
        "levels": ["s", "m", "l"],
        "atoms": 8,
        "k": 4,
        "dim": 16,
    }
    assert {key: record[key] for key in expected} == expected
    assert (record["embedding_model"], record["words"]) == ("", str(Path("scene/words.npz").absolute()))
    assert record["cameras"] == 4
    assert record["geometry"] == str(Path("scene/point_cloud.ply").absolute())
    assert record["provenance"]["settings"]["n_atoms"] == 8
    out = run("info", "f.scoup")[1]
    assert "kind: language field\n" in out
    assert "\n  settings:\n    " in out


def test_a_field_whose_geometry_is_gone():
    Path("scene/point_cloud.ply").unlink()
    assert run_json("info", "f.scoup")["geometry"].endswith("point_cloud.ply (not there)")


@pytest.mark.parametrize("name", ["scene/point_cloud.ply", "a.splat"])
def test_a_splat(name):
    if not Path(name).exists():
        save_gaussians(load_gaussians("scene/point_cloud.ply"), name)
    record = run_json("info", name)
    assert (record["kind"], record["gaussians"], record["sh_degree"]) == ("splat", 150, 0)
    assert len(record["fingerprint"]) == 64


def test_a_scene():
    record = run_json("info", "scene")
    assert record["kind"] == "scene"
    assert record["cameras"] == record["with_image"] == record["views_with_regions"] == 4
    assert record["sizes"] == ["40 x 30"]
    assert record["regions"] == {"s": 24, "m": 24, "l": 24}
    assert record["splat"] == "scene/point_cloud.ply"


def test_cameras_of_every_kind():
    cameras = load_cameras("scene")
    write_transforms(cameras, Path("transforms.json"))
    write_inria_cameras(cameras, Path("cameras.json"))
    for name in ("transforms.json", "cameras.json", "scene/sparse/0/cameras.bin", "scene/sparse/0"):
        record = run_json("info", name)
        assert record["cameras"] == 4, name
        assert record["first"] == "view_00.png", name


def test_a_table_of_words():
    record = run_json("info", "scene/words.npz")
    assert (record["kind"], record["dim"], record["names"][0]) == ("word table", 16, "kettle")
    Path("words.json").write_text(json.dumps({"kettle": [1.0, 2.0], "mug": [0.5, 1.0]}))
    assert run_json("info", "words.json")["names"] == ["kettle", "mug"]


def test_region_features():
    record = run_json("info", "scene/language_features")
    assert (record["kind"], record["views"], record["dim"], record["regions"]) == (
        "region features",
        4,
        16,
        72,
    )


def test_what_is_nothing_of_ours():
    Path("empty").mkdir()
    assert "contains nothing that SCOUP reads" in refused("info", "empty")
    Path("a.xyz").write_text("x")
    assert "a.xyz: is not a known kind of file" in refused("info", "a.xyz")
    Path("a.json").write_text("{")
    assert refused("info", "a.json").startswith("a.json: ")
    assert "there is no such file or folder" in refused("info", "nowhere")
