"""scoup build --shard and scoup merge."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from cli_support import QUICK, refused, run, run_json, snapshot, write_scene
from scoup.uplift.storage.paths import folder_bytes, view_file

pytestmark = pytest.mark.usefixtures("here")
SCENE = ("scene", "--model", "scene/words.npz")


def shards(count: int, out: str = "g.scoup") -> list[Path]:
    for number in range(1, count + 1):
        code, _, err = run("build", *SCENE, "--out", out, "--shard", f"{number}/{count}")
        assert code == 0, err
    return sorted(Path(out).parent.glob(f"{Path(out).name}.*-of-{count}.sums"))


def test_shards_become_the_field_that_build_makes():
    paths = shards(3)
    assert [path.name for path in paths] == [f"g.scoup.{number}-of-3.sums" for number in (1, 2, 3)]
    code, out, err = run("merge", *paths, *QUICK)
    assert (code, err) == (0, "")
    assert out.startswith("3 shards merged\nlevel s: ")
    assert Path("g.scoup").read_bytes() == Path("f.scoup").read_bytes()
    assert not list(Path().glob(".*"))


def test_what_is_said_of_a_shard():
    record = run_json("build", *SCENE, "--out", "g.scoup", "--shard", "2/3")
    assert record.pop("seconds") >= 0
    path = Path("g.scoup.2-of-3.sums")
    assert record == {"shard": str(path), "bytes": folder_bytes(path), "views": 1, "of_views": 4}
    record = run_json("merge", path, *QUICK)
    assert (record["views"], record["field"]) == (1, "g.scoup")
    assert record["warnings"] == ["3 views of 4 are in none of the shards; the field is made of the others"]


def test_sums_that_are_kept_serve_updates():
    paths = shards(2)
    assert run("build", *SCENE, *QUICK, "--keep-sums", "--out", "alone.scoup")[0] == 0
    record = run_json("merge", *paths, *QUICK, "--keep-sums")
    assert record["sums"] == "g.scoup.sums"
    assert snapshot(Path("g.scoup.sums")) == snapshot(Path("alone.scoup.sums"))
    assert run_json("update", "g.scoup", "--remove", "view_01.png", "--overwrite")["views"] == 3
    assert "already exists" in refused("merge", *paths, *QUICK, "--keep-sums", "--out", "g.scoup")


def test_shards_move_to_another_folder():
    """The splat and the word table are named relative to where the field is."""
    for path in shards(2):
        Path("there").mkdir(exist_ok=True)
        shutil.copytree(path, Path("there") / path.name)
    run_json("merge", *Path().glob("g.scoup.*.sums"), *QUICK, "--out", "deeper/g.scoup")
    record = run_json("query", "deeper/g.scoup", "kettle", "--camera", "view_00.png", "--out", "answers")
    assert record
    moved = Path("elsewhere") / "splat.ply"
    moved.parent.mkdir()
    Path("scene/point_cloud.ply").rename(moved)
    run_json("merge", *Path().glob("g.scoup.*.sums"), *QUICK, "--out", "h.scoup", "--gaussians", moved)
    assert run_json("info", "h.scoup")["geometry"] == str(moved.absolute())
    message = refused("merge", *Path().glob("g.scoup.*.sums"), *QUICK, "--out", "i.scoup", "--embed-geometry")
    assert "point_cloud.ply" in message


def test_refusals(here):
    paths = shards(2)
    write_scene(here / "other", count=60, seed=3)
    assert run("build", "other", "--out", "o.scoup", "--shard", "1/2")[0] == 0
    cases = {
        ("merge", *paths, "o.scoup.1-of-2.sums", *QUICK): "are shards of other scenes",
        ("merge", *paths, *QUICK, "--out", "f.scoup"): "f.scoup: already exists",
        ("merge", *paths, *QUICK, "--out", "f.ply"): "ends in .scoup",
        ("merge", "gone.sums", "--out", "g.scoup"): "gone.sums: there is no such folder",
        ("merge", "scene/words.npz", "--out", "g.scoup"): "is not a folder of region sums",
        ("merge", "words.sums"): "words.sums: its name does not say which field it is of; pass --out",
        ("merge", *paths, "--n-atoms", "0"): "must not exceed the 0 atoms",
        ("build", *SCENE, "--out", "g.scoup", "--shard", "1/2"): "g.scoup.1-of-2.sums: already exists",
        ("build", *SCENE, "--out", "g.scoup", "--shard", "5/4"): "invalid shard '5/4'; expected I/N",
        ("build", *SCENE, "--shard", "1/4", "--keep-sums", "--k", "1"): "pass --k, --keep-sums to scoup merge",
        ("build", *SCENE, "--shard", "1/4", "--sums", paths[0]): "there is nothing to rasterise",
    }  # fmt: skip
    for arguments, said in cases.items():
        assert said in refused(*arguments), arguments


def test_info_of_shards_and_sums():
    path = shards(3)[0]
    record = run_json("info", path)
    assert (record["kind"], record["views"], record["of_views"]) == ("shard", 2, 4)
    assert (record["embedding_model"], record["words"]) == ("", str(Path("scene/words.npz").absolute()))
    assert run("build", *SCENE, *QUICK, "--keep-sums", "--out", "alone.scoup")[0] == 0
    record = run_json("info", "alone.scoup.sums")
    assert (record["kind"], record["views"], record["codes"]) == ("region sums", 4, "kept")
    (path / view_file("view_03.png")).unlink()
    assert "lacks the region sums of view_03.png" in refused("info", path)
