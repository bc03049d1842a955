"""What is missing, damaged or mismatched: one sentence that names the file and the remedy, and nothing changes."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from cli_support import ASK, BUILD, FREE, QUICK, refused, run, run_json, write_scene
from io_samples import write_inria_cameras
from scoup.io import load_cameras, save_gaussians, write_colmap, write_transforms
from scoup.scene import Cameras
from support import make_camera, random_gaussians

pytestmark = pytest.mark.usefixtures("here")

PLY, PHOTO, TABLE, FIELD = "scene/point_cloud.ply", "scene/images/view_01.png", "scene/words.npz", "f.scoup"


def cut(file: str) -> None:
    Path(file).write_bytes(Path(file).read_bytes()[: Path(file).stat().st_size * 3 // 5])


def emptied(file: str) -> None:
    Path(file).write_bytes(b"")


def text(file: str) -> None:
    Path(file).write_text("these are not the bytes you are looking for\n" * 9)


def a_folder(file: str) -> None:
    Path(file).unlink()
    Path(file).mkdir()


# ---- files that are damaged


@pytest.mark.parametrize(("verb", "damage"), [
    ("query", cut), ("query", emptied), ("query", text), ("query", a_folder), ("select", cut), ("render", text),
])  # fmt: skip
def test_damaged_inputs_of_verbs_that_ask(verb, damage):
    for file in (TABLE, PLY, FIELD):
        damage(file)
        assert Path(file).name in refused(*ASK[verb])


# ---- files that are not there, or not what they should be


@pytest.mark.parametrize(
    ("missing", "arguments", "named", "remedy"),
    [
        ("scene", BUILD, "scene", "check the path"),
        (PLY, BUILD, "scene: contains no trained splat", "--gaussians"),
        ("scene/sparse", BUILD, "scene: contains no cameras", "COLMAP"),
        ("scene/language_features", (*BUILD, "--sums", "s"), "scene/language_features", "--features"),
        (PLY, ASK["query"], "point_cloud.ply: is not there", "--gaussians"),
        (PLY, ASK["select"], "point_cloud.ply: is not there", "--gaussians"),
        (PLY, ("render", "f.scoup"), "point_cloud.ply: is not there", "--gaussians"),
        (TABLE, ASK["query"], "scene/words.npz: is missing", "--text"),
    ],
)  # fmt: skip
def test_missing_files(missing, arguments, named, remedy):
    shutil.rmtree(missing) if Path(missing).is_dir() else Path(missing).unlink()
    message = refused(*arguments)
    assert named in message
    assert remedy in message


# ---- files of another scene


def rewrite(file: str, change: Callable[[np.ndarray], np.ndarray]) -> None:
    np.save(file, change(np.load(file)))


def test_features_of_another_model_than_the_table():
    for number in range(4):
        rewrite(f"scene/language_features/view_0{number}_f.npy", lambda rows: rows[:, :8])
    message = refused(*BUILD, "--model", TABLE)
    assert (
        "scene/words.npz: contains vectors of 16 dimensions, but scene/language_features contains embeddings of 8"
        in message
    )
    assert run("build", "scene", *QUICK, "--out", "a.scoup")[0] == 0
    message = refused("query", "a.scoup", "kettle", "--text", TABLE)
    assert "scene/words.npz: has vectors of 16 dimensions, but the field contains embeddings of 8" in message


def test_views_without_any_region():
    for number in range(4):
        rewrite(f"scene/language_features/view_0{number}_s.npy", lambda labels: np.full_like(labels, -1))
    assert "region" in refused(*BUILD)


def test_a_splat_without_finite_values():
    gaussians = random_gaussians(20, 0)
    gaussians.means[:] = torch.nan
    save_gaussians(gaussians, "nan.ply")
    code, out, err = run(*BUILD, "--gaussians", "nan.ply")
    assert (code, out) == (2, "")
    assert "error: nan.ply: contains no Gaussians with finite values" in err.splitlines()[-1]
    assert not Path("a.scoup").exists()


def test_region_sums_of_another_scene():
    assert run(*BUILD, "--keep-sums", "a.sums")[0] == 0
    write_scene(Path("second"), seed=4)
    for option in ("--sums", "--keep-sums"):
        message = refused("build", "second", *QUICK, "--out", "b.scoup", option, "a.sums")
        assert "a.sums: made with other Gaussians" in message


def test_cameras_that_see_nothing():
    cameras = Cameras(make_camera(name=f"view_0{number}.png") for number in range(4))
    for camera in cameras:
        camera.viewmat[2, 3] = -1000
    shutil.rmtree("scene/sparse")
    write_colmap(cameras, "scene/sparse/0")
    assert "scene/point_cloud.ply: does not fit the cameras: 4 of 4 cameras tried see nothing" in refused(
        *BUILD
    )
    for verb in ("query", "render"):
        message = refused(*ASK[verb], "--scene", "scene", "--camera", "all")
        assert message.startswith("scene: the cameras see nothing of the field (view_00.png, view_01.png, ")
        assert message.endswith("check that cameras and splat are in the same frame")


# ---- folders of other kinds


@pytest.mark.parametrize("folder", ["scene/sparse", "scene/sparse/0"])
def test_a_folder_of_colmap_means_its_scene(folder):
    assert run("build", folder, *QUICK)[0] == 0  # finds splat and regions, and is named after the scene
    assert run_json("info", "scene.scoup")["geometry"] == str(Path(PLY).absolute())
    assert run_json("info", folder)["cameras"] == 4


def test_several_models_of_colmap():
    shutil.copytree("scene/sparse/0", "scene/sparse/10")
    shutil.copytree("scene/sparse/0", "scene/sparse/2")
    said = "scene/sparse/0: used, and 2 other COLMAP models not; to use another, pass its folder "
    said += "(scene/sparse/2, scene/sparse/10)"
    assert run_json("info", "scene")["warnings"] == [said]
    assert said in run_json(*BUILD)["warnings"]
    assert said not in run_json("build", "scene/sparse/10", *QUICK, "--out", "b.scoup")["warnings"]
    shutil.rmtree("scene/sparse/0")
    shutil.rmtree("scene/sparse/10")
    assert run_json("info", "scene/sparse")["cameras_from"] == "scene/sparse/2"


def test_unreadable_photographs_are_counted_by_info():
    cut(PHOTO)
    text("scene/images/view_02.png")
    record = run_json("info", "scene")
    assert (record["cameras"], record["with_image"], record["unreadable_photographs"]) == (4, 3, 2)
    first, second = record["unreadable"]
    assert first.startswith("view_01.png cannot be decoded")
    assert second == "view_02.png is not an image that can be read"
    assert run_json("info", "scene/sparse/0/images.bin")["unreadable_photographs"] == 2


def test_whole_photographs_are_not_counted(tmp_path):
    from PIL import Image

    for number, ending in enumerate(("jpg", "webp", "tif")):
        Path(f"scene/images/view_0{number}.png").unlink()
        Image.new("RGB", (40, 30), (9, 99, 199)).save(f"scene/images/view_0{number}.{ending}")
    jpeg = Path("scene/images/view_00.jpg")
    jpeg.write_bytes(jpeg.read_bytes() + b"behind the end, as phones write it")
    record = run_json("info", "scene")
    assert record["with_image"] == 4
    assert "unreadable" not in record
    cut("scene/images/view_01.webp")
    assert run_json("info", "scene")["unreadable_photographs"] == 1


def test_an_extraction_that_fails_at_once_writes_nothing():
    pytest.importorskip("skimage")
    for number in range(4):
        text(f"scene/images/view_0{number}.png")
    free = (*FREE, "--out", "regions/of/it")
    assert "none of the 4 photographs could be read" in refused("extract", "scene", *free)
    assert not [path for path in Path("regions").rglob("*") if path.is_file()]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="pipes of Unix")
def test_a_photograph_that_is_a_named_pipe_is_skipped() -> None:
    image = Path("scene/images/view_00.png")
    image.unlink()
    os.mkfifo(image)
    code, _, err = run("extract", "scene", *FREE, "--out", "regions")
    assert code == 0
    assert "view_00.png: is a named pipe (FIFO), not an image" in err


def outside_transforms(path: str) -> None:
    write_transforms(load_cameras("scene"), "scene/transforms.json")
    content = json.loads(Path("scene/transforms.json").read_text())
    for frame, name in zip(content["frames"], (path, *(["images/view_01.png"] * 3)), strict=False):
        frame["file_path"] = name
    content["frames"] = content["frames"][:2]
    Path("scene/transforms.json").write_text(json.dumps(content))


@pytest.mark.parametrize(
    "path", ["../secret.png", "/home/me/secret.png", "images/../../secret.png", "C:\\secret.png"]
)
def test_images_outside_of_the_scene_are_not_opened(path):
    shutil.copy(PHOTO, "secret.png")
    outside_transforms(path)
    (said,) = [each for each in run_json("info", "scene/transforms.json")["warnings"] if "outside" in each]
    shown = path.replace("\\", "/")
    assert f"names 1 image outside of the scene's folder ({shown}); only those in it are" in said
    assert run_json("info", "scene/transforms.json")["with_image"] == 1
    shutil.copy(PHOTO, "scene/images/secret.png")  # found by its name
    assert run_json("info", "scene/transforms.json")["with_image"] == 2


def test_images_linked_into_the_scene_are_opened():
    shutil.move("scene/images", "elsewhere")
    Path("scene/images").symlink_to(Path("elsewhere").absolute())
    outside_transforms(str(Path("scene/images/view_00.png").absolute()))
    record = run_json("info", "scene/transforms.json")
    assert record["with_image"] == 2
    assert "warnings" not in record


def test_names_of_colmap_and_inria_that_leave_the_scene():
    cameras = Cameras(replace(camera, name=f"../{camera.name}") for camera in load_cameras("scene"))
    write_colmap(cameras, "other/sparse/0")
    write_inria_cameras(cameras, "third/cameras.json")
    for file in ("other/sparse/0/images.bin", "third/cameras.json"):
        said = run_json("info", Path(file).parts[0])["warnings"][0]
        assert f"{file}: names 4 images outside of the scene's folder (../view_00.png, ../view_01.png" in said
