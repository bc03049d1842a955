"""scoup info, on every kind of file."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cli_support import QUICK, refused, run, run_json, write_scene
from io_samples import write_inria_cameras
from scoup.io import (
    load_cameras,
    load_gaussians,
    save_gaussians,
    write_colmap,
    write_transforms,
)
from scoup.io.splats.ply import read_ply_table, write_ply_table
from scoup.scene.cameras import Cameras

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


def fewer_photographs() -> None:
    Path("scene/images/view_01.png").unlink()


def no_photographs() -> None:
    shutil.rmtree("scene/images")


def another_splat() -> None:
    write_scene(Path("elsewhere"), seed=9)
    shutil.copy("elsewhere/point_cloud.ply", "scene/point_cloud.ply")


def blank_photographs() -> None:
    for path in Path("scene/images").iterdir():
        Image.new("RGB", (40, 30)).save(path)


def moving_gaussians() -> None:
    table = read_ply_table("scene/point_cloud.ply")
    table = table.with_column("motion_0", np.zeros(len(table), np.float32))
    write_ply_table(table, "scene/point_cloud.ply", overwrite=True)


def fewer_regions() -> None:
    Path("scene/language_features/view_01_s.npy").unlink()


def regions_of_others() -> None:
    for path in Path("scene/language_features").iterdir():
        path.rename(path.with_name(f"other_{path.name}"))


def equal_names_in_folders() -> None:
    cameras = load_cameras("scene")
    moved = [replace(camera, name=f"cam{number}/0000.png") for number, camera in enumerate(cameras)]
    shutil.rmtree("scene/sparse")
    write_colmap(Cameras(moved), Path("scene/sparse/0"))
    for number, camera in enumerate(cameras):
        (Path("scene/images") / f"cam{number}").mkdir()
        shutil.move(f"scene/images/{camera.name}", f"scene/images/cam{number}/0000.png")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (fewer_photographs, "skipped 1 of 4 cameras without an image (looked for scene/images/view_01.png)"),
        (
            no_photographs,
            "none of the 4 images was found (there is no folder images); using the cameras alone",
        ),
        (another_splat, "scene/point_cloud.ply: does not fit the cameras: 4 of 4 renders tried"),
        (blank_photographs, "whether the cameras fit was not judged"),
        (moving_gaussians, "change with time or have another kernel (motion_0)"),
        (fewer_regions, "skipped 1 of 4 cameras that have no features"),
        (regions_of_others, "has features of none of the 4 cameras: expected view_00_s.npy"),
        (equal_names_in_folders, "share the feature name '0000'; LangSplat's files have no folders"),
    ],
)
def test_what_a_build_would_warn_of(change: Callable[[], None], said: str) -> None:
    change()
    code, _, err = run("info", "scene")
    assert code == 0
    assert f"{said}" in err
    assert said in run("build", "scene", *QUICK, "--out", "a.scoup")[2]


def test_a_scene_whose_data_are_not_whole() -> None:
    Path("half/sparse/0").mkdir(parents=True)
    shutil.copy("scene/sparse/0/cameras.bin", "half/sparse/0")
    shutil.copy("scene/point_cloud.ply", "half")
    said = "half/sparse/0: has cameras.bin but not images.bin"
    assert said in run("info", "half")[2]
    Path("half/point_cloud.ply").unlink()
    assert "has cameras.bin but not images.bin" in refused("info", "half")
