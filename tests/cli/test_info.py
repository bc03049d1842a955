"""scoup info, on every kind of file, and what a build says of the same scene."""

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
from PIL import Image

from cli_support import BUILD, FREE, QUICK, printed, refused, run, run_json, warned, write_scene
from io_samples import write_inria_cameras
from scoup.io import PlyTable, load_cameras, load_gaussians, save_gaussians, write_transforms
from scoup.scene import Cameras
from scoup_lab.data.colmap_model import write_colmap

pytestmark = pytest.mark.usefixtures("here")

SPLAT = {"kind": "splat", "gaussians": 150, "sh_degree": 0}
CAMERAS = {"cameras": 4, "first": "view_00.png"}
RECORDS: dict[str, dict[str, object]] = {
    "f.scoup": {"kind": "language field", "gaussians": 150, "levels": ["s", "m", "l"], "atoms": 8, "k": 4, "dim": 16,
                "embedding_model": "", "cameras": 4},
    "scene/point_cloud.ply": SPLAT,
    "a.splat": SPLAT,
    "scene": {"kind": "scene", "cameras": 4, "with_image": 4, "views_with_regions": 4, "sizes": ["40 x 30"],
              "regions": {"s": 24, "m": 24, "l": 24}, "splat": "scene/point_cloud.ply"},
    "cameras_alone": {"not_found": ["trained splat (contains no trained splat)", "region features"]},
    "transforms.json": CAMERAS, "cameras.json": CAMERAS,
    "scene/sparse/0/cameras.bin": CAMERAS, "scene/sparse/0": CAMERAS,
    "scene/words.npz": {"kind": "word table", "dim": 16}, "words.json": {"names": ["kettle", "mug"]},
    "scene/language_features": {"kind": "region features", "views": 4, "dim": 16, "regions": 72},
}  # fmt: skip


def test_every_kind_of_file():
    save_gaussians(load_gaussians("scene/point_cloud.ply"), "a.splat")
    write_transforms(load_cameras("scene"), "transforms.json")
    shutil.copytree("scene/sparse", "cameras_alone/sparse")
    write_inria_cameras(load_cameras("scene"), "cameras.json")
    Path("words.json").write_text(json.dumps({"kettle": [1.0, 2.0], "mug": [0.5, 1.0]}))
    for name, expected in RECORDS.items():
        record = run_json("info", name)
        assert {key: record[key] for key in expected} == expected, name
        assert expected is not SPLAT or len(record["fingerprint"]) == 64


def test_the_next_command_is_named():
    build = "scoup build scene"
    for path, following in (
        ("f.scoup", "scoup view f.scoup"), ("scene", build),
        ("scene/point_cloud.ply", f"{build}/point_cloud.ply (makes views of it first)"),
    ):  # fmt: skip
        assert printed("info", path).splitlines()[-1] == f"next: {following}"
    assert "next: " not in printed("info", "scene/words.npz")


def test_a_field_says_where_its_parts_are():
    record = run_json("info", "f.scoup")
    assert record["words"] == str(Path("scene/words.npz").absolute())
    assert record["geometry"] == str(Path("scene/point_cloud.ply").absolute())
    assert record["provenance"]["settings"]["n_atoms"] == 8
    out = run("info", "f.scoup")[1]
    assert "\n  settings:\n    " in out
    Path("scene/point_cloud.ply").unlink()
    assert run_json("info", "f.scoup")["geometry"].endswith("point_cloud.ply (not there)")


def another_splat() -> None:
    write_scene(Path("elsewhere"), seed=9)
    shutil.copy("elsewhere/point_cloud.ply", "scene/point_cloud.ply")


def moving_gaussians() -> None:
    table = PlyTable.read("scene/point_cloud.ply")
    table = table.with_column("motion_0", np.zeros(len(table), np.float32))
    table.write("scene/point_cloud.ply", overwrite=True)


def each_file(folder: str, change: Callable[[Path], object]) -> Callable[[], object]:
    return lambda: [change(path) for path in Path("scene", folder).iterdir()]


def equal_names_in_folders() -> None:
    cameras = load_cameras("scene")
    moved = [replace(camera, name=f"cam{number}/0000.png") for number, camera in enumerate(cameras)]
    shutil.rmtree("scene/sparse")
    write_colmap(Cameras(moved), Path("scene/sparse/0"))
    for number, camera in enumerate(cameras):
        (Path("scene/images") / f"cam{number}").mkdir()
        shutil.move(f"scene/images/{camera.name}", f"scene/images/cam{number}/0000.png")


def rename(path: Path) -> None:
    path.rename(path.with_name(f"other_{path.name}"))


CHANGES = {
    "fewer photographs": (lambda: Path("scene/images/view_01.png").unlink(),
                          "skipped 1 of 4 cameras without an image (looked for scene/images/view_01.png; scene/"),
    "no photographs": (lambda: shutil.rmtree("scene/images"),
                       "none of the 4 images was found (there is no folder scene/images); using the cameras alone"),
    "another splat": (another_splat, "scene/point_cloud.ply: does not fit the cameras: 4 of 4 renders tried"),
    "blank photographs": (each_file("images", Image.new("RGB", (40, 30)).save),
                          "whether the cameras fit was not judged"),
    "moving Gaussians": (moving_gaussians, "change with time or have another kernel (motion_0)"),
    "fewer regions": (lambda: Path("scene/language_features/view_01_s.npy").unlink(),
                      "skipped 1 of 4 cameras that have no features"),
    "regions of others": (each_file("language_features", rename),
                          "has regions of none of the 4 cameras: expected view_00_s.npy"),
    "equal names": (equal_names_in_folders, "share the feature name '0000'; LangSplat's files have no folders"),
}  # fmt: skip


@pytest.mark.parametrize(("change", "said"), CHANGES.values(), ids=CHANGES)
def test_what_a_build_would_warn_of(change: Callable[[], object], said: str) -> None:
    change()
    assert said in warned("info", "scene")
    assert said in run("build", "scene", *QUICK, "--out", "a.scoup")[2]


def test_a_scene_whose_data_are_not_whole() -> None:
    Path("half/sparse/0").mkdir(parents=True)
    shutil.copy("scene/sparse/0/cameras.bin", "half/sparse/0")
    shutil.copy("scene/point_cloud.ply", "half")
    said = "half/sparse/0: has cameras.bin but not images.bin"
    assert said in run("info", "half")[2]
    Path("half/point_cloud.ply").unlink()
    assert said.partition(": ")[2] in refused("info", "half")


# ---- scenes that are laid out in other ways


def test_a_folder_of_colmap_means_its_scene():
    # The build finds splat and regions, and its field is named after the scene.
    run_json("build", "scene/sparse", *QUICK)
    run_json("build", "scene/sparse/0", *BUILD[2:])
    assert run_json("info", "scene.scoup")["geometry"] == str(Path("scene/point_cloud.ply").absolute())
    assert run_json("info", "scene/sparse")["cameras"] == 4


def test_several_models_of_colmap():
    shutil.copytree("scene/sparse/0", "scene/sparse/10")
    shutil.copytree("scene/sparse/0", "scene/sparse/2")
    said = "scene/sparse/0: used, with 4 images, and not scene/sparse/2 (4), scene/sparse/10 (4); to use "
    said += "another COLMAP model, pass its folder"
    assert run_json("info", "scene")["warnings"] == [said]
    assert said in run_json(*BUILD)["warnings"]
    assert said not in run_json("info", "scene/sparse/10").get("warnings", [])


def test_of_models_with_as_many_images_the_one_that_fits_the_splat():
    shutil.copytree("scene/sparse/0", "scene/sparse/1")
    turned = torch.tensor([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]]).double()
    elsewhere = [camera.moved(turned, [9.0, 9.0, 9.0]) for camera in load_cameras("scene/sparse/1")]
    write_colmap(Cameras(elsewhere), "scene/sparse/0", overwrite=True)
    said = run_json("info", "scene")
    assert (said["cameras_from"], said["fit"]["verdict"]) == ("scene/sparse/1", "fits")
    assert "scene/sparse/1: used, as it fits the splat better (similarity" in said["warnings"][0]
    assert run_json(*BUILD)["warnings"][0] == said["warnings"][0]
    assert run_json("extract", "scene", *FREE, "--out", "r")["warnings"] == said["warnings"]
    Path("scene/point_cloud.ply").rename("splat.ply")
    for verb in (("info", "scene"), ("extract", "scene", *FREE, "--out", "r")):
        assert "has as many images (4) as scene/sparse/1; pass the folder of the model" in refused(*verb)
    assert run_json("extract", "scene", *FREE, "--out", "r", "--gaussians", "splat.ply")["kept"] == 4


def test_unreadable_photographs_are_counted_by_info():
    images = Path("scene/images")
    for number, ending in enumerate(("jpg", "webp", "tif")):
        (images / f"view_0{number}.png").unlink()
        Image.new("RGB", (40, 30), (9, 99, 199)).save(images / f"view_0{number}.{ending}")
    with open(images / "view_00.jpg", "ab") as jpeg:
        jpeg.write(b"behind the end, as phones write it")
    record = run_json("info", "scene")
    assert (record["with_image"], "unreadable" in record) == (4, False)
    for name in ("view_01.webp", "view_03.png"):
        content = (images / name).read_bytes()
        (images / name).write_bytes(content[: len(content) * 3 // 5])
    record = run_json("info", "scene")
    assert (record["cameras"], record["with_image"], record["unreadable_photographs"]) == (4, 3, 2)
    first, second = record["unreadable"]
    assert first == "view_01.png is not an image that can be read"
    assert second.startswith("view_03.png cannot be decoded")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="pipes of Unix")
def test_a_photograph_that_is_a_named_pipe_is_skipped() -> None:
    image = Path("scene/images/view_00.png")
    image.unlink()
    os.mkfifo(image)
    said = warned("extract", "scene", *FREE, "--out", "regions")
    assert "view_00.png: is a named pipe (FIFO), not an image" in said


def outside_transforms(path: str) -> None:
    """Two cameras, one of them with an image at this path."""
    file = Path("scene/transforms.json")
    write_transforms(load_cameras("scene"), file)
    content = json.loads(file.read_text())
    first, second, *_ = content["frames"]
    frames = [{**first, "file_path": path}, {**second, "file_path": "images/view_01.png"}]
    file.write_text(json.dumps({**content, "frames": frames}))


@pytest.mark.parametrize(
    "path", ["../secret.png", "/home/me/secret.png", "images/../../secret.png", "C:\\secret.png"]
)
def test_images_outside_of_the_scene_are_not_opened(path):
    shutil.copy("scene/images/view_01.png", "secret.png")
    outside_transforms(path)
    (said,) = [each for each in run_json("info", "scene/transforms.json")["warnings"] if "outside" in each]
    shown = path.replace("\\", "/")
    assert f"names 1 image outside of the scene's folder ({shown}); only those in it are" in said
    shutil.copy("scene/images/view_01.png", "scene/images/secret.png")  # found by its name
    assert run_json("info", "scene/transforms.json")["with_image"] == 2


@pytest.mark.parametrize("file", ["other/sparse/0/images.bin", "other/cameras.json"])
def test_names_of_colmap_and_inria_that_leave_the_scene(file):
    cameras = Cameras(replace(camera, name=f"../{camera.name}") for camera in load_cameras("scene"))
    if file.endswith(".bin"):
        write_colmap(cameras, "other/sparse/0")
    else:
        write_inria_cameras(cameras, file)
    said = run_json("info", "other")["warnings"][0]
    assert f"{file}: names 4 images outside of the scene's folder (../view_00.png, ../view_01.png" in said
