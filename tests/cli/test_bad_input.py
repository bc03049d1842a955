"""What is missing, damaged or mismatched: one sentence that names the file and the remedy, and nothing changes."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from cli_support import ASK, BUILD, QUICK, WORDS, refused, run, run_json, write_scene
from io_samples import write_inria_cameras
from scoup.io import (
    load_cameras,
    save_gaussians,
    write_colmap,
    write_transforms,
)
from scoup.models.word_table import save_table
from scoup.models.words import CANONICAL_PHRASES
from scoup.scene.cameras import Cameras
from scoup.uplift.storage.array_file import view_file
from support import make_camera, random_gaussians

pytestmark = pytest.mark.usefixtures("here")

PLY, CAMERAS, IMAGES = "scene/point_cloud.ply", "scene/sparse/0/cameras.bin", "scene/sparse/0/images.bin"
LABELS, ROWS = "scene/language_features/view_01_s.npy", "scene/language_features/view_01_f.npy"
PHOTO, TABLE, FIELD = "scene/images/view_01.png", "scene/words.npz", "f.scoup"


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
        (None, (*BUILD, "--gaussians", "no.ply"), "no.ply", "check the path"),
        (None, (*BUILD, "--features", "no"), "no: there is no such folder", "check the path"),
        (None, (*BUILD, "--images", "no"), "no: there is no such folder of images", "check the path"),
        (None, (*BUILD, "--model", "no.npz"), "no.npz: there is no such file", "check the path"),
        (FIELD, ASK["query"], "f.scoup: there is no such file", "check the path"),
        (FIELD, ASK["select"], "f.scoup: there is no such file", "check the path"),
        (FIELD, ASK["render"], "f.scoup: there is no such file", "check the path"),
        (PLY, ASK["query"], "point_cloud.ply: is not there", "--gaussians"),
        (PLY, ASK["select"], "point_cloud.ply: is not there", "--gaussians"),
        (PLY, ("render", "f.scoup"), "point_cloud.ply: is not there", "--gaussians"),
        (TABLE, ASK["query"], "scene/words.npz: is missing", "--text"),
        (None, (*ASK["query"], "--scene", "no"), "no: there is no such file or folder", "check the path"),
        (None, (*ASK["query"], "--gaussians", "no.ply"), "no.ply: there is no such file", "check the path"),
        (None, (*ASK["select"], "--text", "no.json"), "no.json: there is no such file", "check the path"),
    ],
)  # fmt: skip
def test_missing_files(missing, arguments, named, remedy):
    if missing is not None:
        shutil.rmtree(missing) if Path(missing).is_dir() else Path(missing).unlink()
    message = refused(*arguments)
    assert named in message
    assert remedy in message


def test_the_field_given_where_the_splat_belongs_and_the_reverse():
    assert "f.scoup: is not a kind of splat" in refused(*BUILD, "--gaussians", "f.scoup")
    assert "point_cloud.ply: is not a SCOUP language field" in refused("query", PLY, "kettle")
    assert "scene: is a folder" in refused("query", "scene", "kettle")
    assert "is a file, not a folder" in refused(*BUILD, "--features", PLY)
    assert (
        "cameras.bin: is not a splat, and none is named; name the trained splat with --gaussians"
        in refused("build", CAMERAS, "--out", "a.scoup")
    )


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


def test_geometry_of_another_field():
    save_gaussians(random_gaussians(150, 5), "other.ply")
    save_gaussians(random_gaussians(30, 5), "small.ply")
    for verb in ASK:
        message = refused(*ASK[verb], "--gaussians", "other.ply")
        assert (
            "other.ply: not the geometry this field was built on (as many Gaussians, but others)" in message
        )
        message = refused(*ASK[verb], "--gaussians", "small.ply")
        assert (
            "small.ply: not the geometry this field was built on (30 Gaussians, the field has 150)" in message
        )
    shutil.move("other.ply", PLY)
    assert "point_cloud.ply: not the geometry" in refused(*ASK["query"])


def test_region_sums_that_do_not_fit():
    assert run(*BUILD, "--keep-sums", "a.sums")[0] == 0
    write_scene(Path("second"), seed=4)
    build = ("build", "second", *QUICK, "--out", "b.scoup")
    for option in ("--sums", "--keep-sums"):
        assert "a.sums: made with other Gaussians" in refused(*build, option, "a.sums")
        message = refused(*BUILD, "--overwrite", "--scale", "0.5", option, "a.sums")
        assert "a.sums: made with other scale (auto); make them from the same splat" in message
    assert "no.sums: there is no such folder" in refused(*build, "--sums", "no.sums")
    assert "a.scoup: is not a folder of region sums" in refused(*build, "--sums", "a.scoup")
    assert "no.scoup: there is no such file" in refused(*build, "--codebook", "no.scoup")
    view = Path("a.sums") / view_file("view_01.png")
    damaged = bytearray(view.read_bytes())
    damaged[len(damaged) // 2] ^= 1
    view.write_bytes(damaged)
    again = ("build", "scene", *QUICK, "--out", "c.scoup")
    assert f"{view}: is damaged" in refused(*again, "--sums", "a.sums")
    assert (
        f"{view}: is damaged (checksum)" in run(*again, "--keep-sums", "a.sums")[2]
    )  # a warning: made again
    assert Path("c.scoup").read_bytes() == Path("a.scoup").read_bytes()


def test_cameras_that_see_nothing():
    cameras = Cameras(make_camera(name=f"view_0{number}.png") for number in range(4))
    for camera in cameras:
        camera.viewmat[2, 3] = -1000
    shutil.rmtree("scene/sparse")
    write_colmap(cameras, "scene/sparse/0")
    message = refused(*BUILD)
    assert message.startswith(
        "scene/point_cloud.ply: does not fit the cameras: 4 of 4 cameras tried see nothing"
    )
    assert "--no-check-fit" in message
    message = refused(*BUILD, "--no-check-fit")
    assert message.startswith("the cameras see nothing: no Gaussian contributes to a region of any view; use")
    for verb in ("query", "render"):
        message = refused(*ASK[verb], "--scene", "scene", "--camera", "all")
        assert message.startswith("scene: the cameras see nothing of the field (view_00.png, view_01.png, ")
        assert message.endswith("check that cameras and splat are in the same frame")
    assert not Path("answers").exists()


# ---- files of other kinds


def test_words_for_a_field_of_another_model(here):
    names = [*WORDS, *CANONICAL_PHRASES]
    save_table("wide.npz", names, np.random.default_rng(0).normal(size=(len(names), 512)))
    wide = ("--text", "wide.npz")
    assert "scene/words.npz: pass that, or a word table of 16" in refused(*ASK["query"], *wide)
    # Features that do not name their model, and that the usual one cannot have made: none is guessed.
    assert run(*BUILD)[0] == 0
    ask = ("query", "a.scoup", "kettle", "--out", "answers")
    assert "a.scoup: names no embedding model; pass a word table or model as --text" in refused(*ask)
    assert "the field does not name its model: pass a word table of 16 dimensions" in refused(*ask, *wide)
    assert run("build", "scene", *QUICK, "--out", "b.scoup", "--model", "colors")[0] == 0
    for text in ((), wide):
        message = refused("query", "b.scoup", "kettle", "--out", "answers", *text)
        assert "cannot be queried in words; extract them with a CLIP model" in message


@pytest.mark.parametrize("name", ["scene/language_features/view_00_f.npy", "gone.pt", "words.csv", "README"])
def test_a_file_that_is_no_table_of_words(name):
    Path("README").write_text("no words")
    message = refused(*ASK["query"], "--text", name)
    assert message.startswith(f"{name}: is no")
    assert "pass a table (.npz with names and vectors, .json with name: numbers, or .safetensors" in message


def test_a_file_where_a_model_belongs():
    pytest.importorskip("skimage")
    extract = ("extract", "scene", "--segmenter", "felzenszwalb", "--out", "regions")
    assert "it is a file; pass a folder with config.json" in refused(*extract, "--embedder", PLY)


@pytest.mark.parametrize(("name", "said"), [
    ("a.lcc", "splats in .lcc files are not read; convert it with splat-transform (splat-transform a.lcc a.ply), or "
              "open it in the SuperSplat editor"),
    ("a.usdz", ".usdz files are not read, whether they hold a splat or a mesh; export the trained splat as PLY"),
    ("a.las", "a .las file contains a mesh or a point cloud, not a trained splat; use the splat that training"),
    ("a.ply.gz", "is an archive; unpack it"),
])  # fmt: skip
def test_formats_that_are_not_read(name, said):
    Path(name).write_bytes(b"x")
    for arguments in (("info", name), (*BUILD, "--gaussians", name)):
        assert f"{name}: {said}" in refused(*arguments)


@pytest.mark.parametrize(("name", "content", "said"), [
    ("transforms.json", '[{"file_path": "a.png"}]',
     "[0].img_name is missing, expected a text; a JSON list is read as cameras of"),
    ("transforms.json", "[1,", "is not valid JSON (line 1); the file should contain cameras of nerfstudio (an object"),
    ("cameras.json", '{"a": 1}', "frames is missing, expected a list; a JSON object is read as nerfstudio's"),
    ("other.json", '{"frames": [{}]}', "frames[0].file_path is missing, expected a text; a JSON object is read as"),
])  # fmt: skip
def test_json_of_another_kind_than_its_name_says(name, content, said):
    Path(name).write_text(content)
    for arguments in (
        ("info", name),
        ("extract", name),
        ("build", name, "--gaussians", PLY, "--out", "a.scoup"),
    ):
        assert f"{name}: {said}" in refused(*arguments)


# ---- folders of other kinds


@pytest.mark.parametrize("folder", ["scene/sparse", "scene/sparse/0"])
def test_a_folder_of_colmap_means_its_scene(folder):
    assert (
        run("build", folder, *QUICK)[0] == 0
    )  # finds splat and regions, and calls the field after the scene
    assert run_json("info", "scene.scoup")["geometry"] == str(Path(PLY).absolute())
    assert run_json("info", folder)["cameras"] == 4


def test_several_models_of_colmap():
    shutil.copytree("scene/sparse/0", "scene/sparse/10")
    shutil.copytree("scene/sparse/0", "scene/sparse/2")
    said = (
        "scene/sparse/0: used, and 2 other COLMAP models not; to use another, pass its folder "
        "(scene/sparse/2, scene/sparse/10)"
    )
    assert run_json("info", "scene")["warnings"] == [said]
    assert said in run_json(*BUILD)["warnings"]
    assert said not in run_json("build", "scene/sparse/10", *QUICK, "--out", "b.scoup")["warnings"]
    shutil.rmtree("scene/sparse/0")
    shutil.rmtree("scene/sparse/10")
    assert run_json("info", "scene/sparse")["cameras_from"] == "scene/sparse/2"


def test_a_folder_in_a_scene_or_above_scenes():
    assert "scene/images: contains nothing that SCOUP reads" in (message := refused("info", "scene/images"))
    assert "use the scene it is in: scene" in message
    assert "use the scene it is in: scene" in refused("build", "scene/images", "--out", "a.scoup")
    iteration = Path("trained/point_cloud/iteration_30000")
    iteration.mkdir(parents=True)
    shutil.copy(PLY, iteration)
    write_inria_cameras(load_cameras("scene"), "trained/cameras.json")
    assert "use the scene it is in: trained" in refused("build", iteration, "--out", "a.scoup")
    Path("all").mkdir()
    shutil.move("scene", "all/kitchen")
    assert "use one of the scenes in it: all/kitchen" in refused("build", "all", "--out", "a.scoup")
    assert "use one of the scenes in it: all/kitchen" in refused("info", "all")


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


def test_an_extraction_that_fails_at_once_leaves_nothing():
    pytest.importorskip("skimage")
    for number in range(4):
        text(f"scene/images/view_0{number}.png")
    free = ("--segmenter", "felzenszwalb", "--embedder", "colors", "--out", "regions/of/it")
    assert "none of the 4 photographs could be read" in refused("extract", "scene", *free)
    assert not Path("regions").exists()


@pytest.mark.parametrize(("source", "target", "said"), [
    ("scene", "scene", "source and target are one folder; use a new folder, such as scene/language_features_"),
    ("scene/language_features", "scene", "scene: contains other files than region features (images, point_cloud"),
    ("scene", "scene/images", "scene/images: contains other files than region features (view_00.png, view_01.png"),
])  # fmt: skip
def test_regions_converted_into_a_folder_of_other_things(source, target, said):
    for options in ((), ("--to", "compact"), ("--overwrite",)):
        assert said in refused("convert", source, target, *options)


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
    assert (
        f"names 1 image outside of the scene's folder ({path.replace(chr(92), '/')}); only those in it are"
        in said
    )
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
        said = run_json("info", Path(file).parts[0])["warnings"]
        assert (
            f"{file}: names 4 images outside of the scene's folder (../view_00.png, ../view_01.png" in said[0]
        )
