"""scoup build and transfer: what is special of them, and what they say of splats and cameras that do not fit."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from cli_support import BUILD, FREE, QUICK, printed, refused, run, run_json, snapshot, together, write_scene
from messages import check_message
from scoup.base import Registry
from scoup.extract import lacks_views
from scoup.io import load_cameras, load_gaussians, save_gaussians, save_png
from scoup.io.splats import formats
from scoup.io.splats.ply import FORMAT, read_ply
from scoup.io.splats.splat_format import SplatFormat
from scoup.models import WordTable
from scoup.query import LanguageField
from scoup.scene import Cameras, Gaussians
from scoup.uplift.settings import BUILD_PRESETS
from scoup_lab.data.colmap_model import write_colmap
from uplift.edits import joined

pytestmark = pytest.mark.usefixtures("here")


def test_the_default_field():
    """3 levels of 4 atoms, each with an index of 1 byte and a weight of 2; 3 codebooks of 8 atoms of 16 numbers."""
    record = run_json("build", "scene", *QUICK, "--model", "scene/words.npz", "--embed-geometry")
    assert record["bytes"] == Path("scene.scoup").stat().st_size
    field = LanguageField.load("scene.scoup")
    assert field.geometry_path == Path("scene/point_cloud.ply").absolute()
    assert field.info.embedding_model == ""  # that of LangSplat has 512 dimensions
    assert len(field.gaussians) == 150
    info = run_json("info", "scene.scoup")
    assert (info["bytes_of_codes_a_gaussian"], info["bytes_of_codebook"]) == (3 * 4 * 3, 3 * 8 * 16 * 4)


def test_the_usual_model_is_taken_for_embeddings_of_its_size():
    for path in Path("scene/language_features").glob("*_f.npy"):
        np.save(path, np.pad(np.load(path), ((0, 0), (0, 512 - 16))))
    run_json("build", "scene", *QUICK)
    assert LanguageField.load("scene.scoup").info.embedding_model == "laion/CLIP-ViT-B-16-laion2B-s34B-b88K"


def test_settings_reach_the_field(monkeypatch: pytest.MonkeyPatch):
    paper = replace(BUILD_PRESETS["paper"], epochs=2)
    monkeypatch.setitem(BUILD_PRESETS, "paper", paper)  # all 4000 take a minute
    settings = "--k 2 --raster-preset gsplat --preset paper"
    files = "--gaussians scene/point_cloud.ply --features scene/language_features --images scene/images --scale 0.5"
    run_json(*BUILD, *settings.split(), *files.split())
    field = LanguageField.load("a.scoup")
    settings = field.info.provenance["settings"]
    assert settings["raster_preset"] == field.info.raster_preset == "gsplat"
    expected = {"k": 2, "keep": 4, "rounds": 1, "solver": "adam", "epochs": 2, "n_atoms": 8, "scale": 0.5}
    assert {name: settings[name] for name in expected} == expected
    assert field.code_indices.shape == (150, 3, 4)


@pytest.mark.usefixtures("quick_python")
def test_parts_in_processes_of_their_own():
    """At the same time; then one build of all of them, which rasterises nothing."""
    Path("parts").mkdir()
    Path("parts/file").write_bytes(b"precious")  # beside what is there
    whole = run_json("build", "scene", *QUICK, "--out", "whole.scoup", "--keep-sums", "whole.sums")
    parts = [("build", "scene", "--keep-sums", "parts", "--part", f"{number}/3") for number in (1, 2, 3)]
    ended = together(*parts)
    assert [done.returncode for done in ended] == [0, 0, 0], ended
    assert "part 1 of 3, 2 views of 4" in ended[0].stdout
    assert "with all parts there: scoup build scene --sums parts" in ended[0].stdout
    assert snapshot(Path("parts")) == {**snapshot(Path("whole.sums")), "file": b"precious"}
    info = run_json("info", "parts")
    assert (info["kind"], info["views"], info["bytes"]) == ("region sums", 4, whole["sums_bytes"])
    with pytest.MonkeyPatch.context() as patch:
        patch.delattr("scoup.raster.project")
        run_json(*BUILD, "--sums", "parts")
    assert Path("a.scoup").read_bytes() == Path("whole.scoup").read_bytes()
    next(Path("parts").glob("view.view_01*")).unlink()
    message = refused("build", "scene", *QUICK, "--out", "b.scoup", "--sums", "parts")
    assert "parts: lacks the view 'view_01.png'" in message


def test_distorted_cameras_on_request():
    lines = Path("scene/sparse/0")
    shutil.rmtree(lines)
    lines.mkdir()
    lines.joinpath("cameras.txt").write_text("1 SIMPLE_RADIAL 40 30 36 20 15 0.05\n")
    lines.joinpath("images.txt").write_text("1 1 0 0 0 0 0 0 1 view_00.png\n\n")
    assert "--undistort" in refused(*BUILD)
    assert "1 view with regions of 1 camera" in run(*BUILD, "--undistort")[1]
    assert run_json("query", "a.scoup", "kettle", "--text", "scene/words.npz", "--scene", "scene")["answers"]
    assert "scoup build needs --undistort" in run("info", "scene")[1]


def test_a_table_is_named_relative_to_the_field():
    Path("deep").mkdir()
    run_json("build", "scene", *QUICK, "--out", "deep/a.scoup", "--model", "scene/words.npz")
    record = run_json("info", "deep/a.scoup")
    assert (record["embedding_model"], record["words"]) == ("", str(Path("scene/words.npz").absolute()))
    assert run_json("query", "deep/a.scoup", "kettle")["answers"]
    Path("deep").rename("elsewhere")  # beside the scene, as before
    assert run_json("query", "elsewhere/a.scoup", "kettle", "--overwrite")["answers"]


def test_a_table_leaves_the_model_that_its_features_or_it_names():
    table = WordTable.load("scene/words.npz")
    WordTable.save("named.npz", table.names, table.vectors, model="a/model")
    run_json(*BUILD, "--model", "named.npz")
    assert LanguageField.load("a.scoup").info.embedding_model == "a/model"
    run_json("convert", "scene", "compact", "--bits", "32", "--model", "the/maker")
    Path("scene/language_features").rename("others")
    run_json("build", "scene", *QUICK, "--out", "b.scoup", "--features", "compact", "--model", "named.npz")
    field = LanguageField.load("b.scoup")
    assert field.info.embedding_model == "the/maker"
    assert field.info.words == Path("named.npz").absolute()
    said = run("query", "b.scoup", "kettle", "--out", "answers")[2]
    assert "its vectors come from a/model, the field's embeddings from the/maker" in said


def test_cameras_of_one_pixel():
    """Regions of 40 x 30 and of one pixel both belong to such views."""
    cameras = Cameras(camera.resized(1, 1) for camera in load_cameras("scene"))
    write_colmap(cameras, "scene/sparse/0", overwrite=True)
    for number in range(4):
        pixels = torch.full((1, 1, 3), 40 + 50 * number, dtype=torch.uint8)
        save_png(pixels, Path(f"scene/images/view_0{number}.png"), overwrite=True)
    run_json(*BUILD, "--model", "scene/words.npz")
    answers = run_json("query", "a.scoup", "kettle", "--camera", "all", "--out", "q")["answers"]
    assert [answer["pixel"] for answer in answers] == [[0, 0]] * 4
    assert run_json("extract", "scene", *FREE, "--out", "r")["regions"] == 12
    run_json("build", "scene", *QUICK, "--features", "r", "--out", "b.scoup")


def test_regions_are_made_and_resumed():
    made = Path("scene/language_features")
    shutil.rmtree(made)
    made.mkdir()  # as of a run that failed early
    out = run("build", "scene", *FREE, *QUICK, "--out", "a.scoup")[1]
    assert "s in all; look at it: scoup view a.scoup, or scoup render a.scoup --what codes" in out
    run_json("render", "a.scoup", "--what", "codes")
    assert not lacks_views(made, Path("scene"), None, "colors")
    next(made.glob("*.regions")).unlink()
    assert not lacks_views(made, Path("scene"), None, "a model of their own")
    said = run_json("build", "scene", *FREE, *QUICK, "--out", "c.scoup")
    assert (said["extraction"]["made"], said["extraction"]["kept"], said["views"]) == (1, 3, 4)
    Path("scene/masks").mkdir()
    mask = torch.ones(30, 40, 3, dtype=torch.uint8)
    mask[:, 30:] = 0
    save_png(mask, Path("scene/masks/view_01.png"))
    for options, made in ((("--no-masks",), 0), (("--masks", "white"), 1), (("--masks", "black"), 1)):
        said = run_json("build", "scene", *FREE, *QUICK, *options, "--out", "c.scoup", "--overwrite")
        assert (said["extraction"]["made"], said["extraction"]["kept"]) == (made, 4 - made)
    for options in (("--features", "scene/language_features"), ("--keep-sums", "sums", "--part", "1/2")):
        assert "--no-masks" in refused("build", "scene", "--no-masks", *options)


def test_absurd_gaussians_are_counted():
    gaussians = load_gaussians("scene/point_cloud.ply")
    gaussians.scales[:3] = 1e34
    save_gaussians(gaussians, "odd.ply")
    said = "3 of 150 Gaussians are over 100 times larger than the scene; export or train"
    assert said in run_json("info", "odd.ply")["warnings"][0]
    assert said in run("build", "scene", *QUICK, "--gaussians", "odd.ply", "--out", "a.scoup")[2]


# ---- splats and cameras that do not fit


def test_info_reads_a_splat_once(monkeypatch: pytest.MonkeyPatch):
    read: list[Path] = []

    def counted_read(path: Path) -> Gaussians:
        read.append(path)
        return read_ply(path)

    table = [replace(FORMAT, read=counted_read)]
    monkeypatch.setattr(formats, "FORMATS", Registry("splat format", "none", SplatFormat, table))
    assert run_json("info", "scene")["fit"]["verdict"] == "fits"
    assert read == [Path("scene/point_cloud.ply")]


def test_the_splat_of_another_scene_is_refused_before_the_work():
    write_scene(Path("elsewhere"), seed=9)
    check_message(re.sub(r"-?0\.\d+", "#", refused(*BUILD, "--gaussians", "elsewhere/point_cloud.ply")))
    shutil.copy("elsewhere/point_cloud.ply", "scene/point_cloud.ply")
    assert run_json("info", "scene")["fit"]["verdict"] == "hopeless"
    check_message(re.sub(r"-?0\.\d+", "#", refused("extract", "scene", *FREE, "--out", "r", "--views", 2)))
    assert run_json(*BUILD, "--no-check-fit")["views"] == 4


def test_cameras_follow_a_splat_into_the_frame_of_its_training():
    shift, scale = (3.0, -1.0, 2.0), 0.7
    gaussians = load_gaussians("scene/point_cloud.ply")
    means = scale * (gaussians.means + gaussians.means.new_tensor(shift))
    save_gaussians(replace(gaussians, means=means, scales=scale * gaussians.scales), "trained.ply")
    trained = (*BUILD, "--gaussians", "trained.ply")
    assert "does not fit the cameras" in refused(*trained)
    rows = [[float(row == column) for column in range(3)] + [shift[row]] for row in range(3)]
    Path("dataparser_transforms.json").write_text(json.dumps({"transform": rows, "scale": scale}))
    words = ("--model", "scene/words.npz")
    printed(*trained, *words, "--dataparser-transforms", "dataparser_transforms.json")


# ---- transfer


def test_an_embedded_splat_is_replaced_by_the_edited_one() -> None:
    splat = load_gaussians("scene")
    edited = joined(splat.select(slice(5, None)), replace(splat, means=splat.means + 100).select([7]))
    save_gaussians(edited, "edited.ply")
    field = LanguageField.load("f.scoup", splat)
    field.geometry_path = None
    field.save("whole.scoup")
    run_json("transfer", "whole.scoup", "edited.ply", "--out", "b.scoup")
    Path("edited.ply").unlink()
    moved = LanguageField.load("b.scoup")
    assert moved.gaussians.fingerprint() == edited.fingerprint()
    assert moved.code_weights[:-1].equal(field.code_weights[5:])
    assert not moved.code_weights[-1].any()
