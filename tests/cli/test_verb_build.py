"""scoup build."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import torch

import scoup
from cli_support import QUICK, run, run_json, snapshot
from scoup.field.language_field import LanguageField
from scoup.io import save_png

pytestmark = pytest.mark.usefixtures("here")


def test_the_main_path_says_what_it_did():
    code, out, err = run("build", "scene", *QUICK)
    assert (code, err) == (0, "")
    assert "150 Gaussians, 4 views with regions of 4 cameras" in out
    assert "level m: 24 regions, mean cosine" in out
    assert "of 150 Gaussians have a code" in out
    field = LanguageField.load("scene.scoup")  # the default name
    assert field.geometry_path == Path("scene/point_cloud.ply").absolute()
    assert field.info.embedding_model == ""  # that of LangSplat has 512 dimensions
    assert field.info.provenance["settings"]["k"] == 4
    assert field.cameras is not None
    assert field.cameras.names[0] == "view_00.png"
    assert len(field.gaussians) == 150


def test_the_usual_model_is_taken_for_embeddings_of_its_size():
    for path in Path("scene/language_features").glob("*_f.npy"):
        np.save(path, np.pad(np.load(path), ((0, 0), (0, 512 - 16))))
    assert run("build", "scene", *QUICK)[0] == 0
    assert LanguageField.load("scene.scoup").info.embedding_model == "laion/CLIP-ViT-B-16-laion2B-s34B-b88K"


def test_the_record_for_machines():
    record = run_json("build", "scene", *QUICK, "--out", "a.scoup")
    assert record["field"] == "a.scoup"
    assert record["bytes"] == Path("a.scoup").stat().st_size
    assert (record["gaussians"], record["views"]) == (150, 4)
    assert 0 < record["coded"] <= 150
    assert set(record["coding"]) == {"s", "m", "l"}
    assert "warnings" not in record


def test_settings_reach_the_field():
    run_json(
        *("build", "scene", *QUICK, "--out", "a.scoup", "--k", "2", "--keep", "3", "--seed", "5"),
        *(
            "--raster-preset",
            "gsplat",
            "--tolerance",
            "0.5",
            "--epochs",
            "20",
            "--rounds",
            "2",
            "--gaussians",
            "scene/point_cloud.ply",
        ),
        *("--features", "scene/language_features", "--images", "scene/images", "--solver", "adam"),
    )
    field = LanguageField.load("a.scoup")
    settings = field.info.provenance["settings"]
    assert settings["raster_preset"] == field.info.raster_preset == "gsplat"
    assert [settings[name] for name in ("k", "keep", "seed", "epochs", "n_atoms", "tolerance")] == [
        2,
        3,
        5,
        20,
        8,
        0.5,
    ]
    assert field.code_indices.shape == (150, 3, 3)


def test_same_inputs_same_bytes():
    for name in ("a.scoup", "b.scoup"):
        run_json("build", "scene", *QUICK, "--out", name)
    assert Path("a.scoup").read_bytes() == Path("b.scoup").read_bytes()


def test_eight_bit_weights_make_a_smaller_file():
    big = run_json("build", "scene", *QUICK, "--out", "a.scoup")["bytes"]
    small = run_json("build", "scene", *QUICK, "--out", "b.scoup", "--weight-bits", "8")["bytes"]
    assert big - small >= 150 * 3 * 4
    first, second = LanguageField.load("a.scoup"), LanguageField.load("b.scoup")
    assert torch.allclose(first.code_weights.float(), second.code_weights.float(), atol=0.01)


def test_embedded_geometry_stands_alone():
    run_json("build", "scene", *QUICK, "--out", "a.scoup", "--embed-geometry")
    shutil.rmtree("scene/images")
    Path("scene/point_cloud.ply").unlink()
    assert len(LanguageField.load("a.scoup").gaussians) == 150
    assert run_json("query", "a.scoup", "kettle", "--text", "scene/words.npz")["answers"]


def test_region_sums_are_kept_on_request_and_built_from_again(monkeypatch):
    record = run_json("build", "scene", *QUICK, "--out", "a.scoup", "--keep-sums")
    assert record["sums"] == "a.scoup.sums"
    assert record["sums_bytes"] == Path("a.scoup.sums").stat().st_size
    assert run_json("info", "a.scoup")["region_sums"] == record["sums_bytes"]
    before = snapshot(Path())
    run_json("build", "scene", *QUICK, "--out", "whole.scoup", "--seed", "5", "--rounds", "3")

    def no_look(*_, **__):
        raise AssertionError("nothing is rasterised")

    monkeypatch.setattr("scoup.raster.project", no_look)
    again = ("build", "scene", *QUICK, "--sums", "a.scoup.sums")
    run_json(*again, "--out", "b.scoup", "--seed", "5", "--rounds", "3")
    assert Path("b.scoup").read_bytes() == Path("whole.scoup").read_bytes()
    run_json(*again, "--out", "c.scoup")
    assert Path("c.scoup").read_bytes() == before["a.scoup"]
    assert Path("a.scoup.sums").read_bytes() == before["a.scoup.sums"]


def test_region_sums_are_not_replaced_unasked():
    Path("a.scoup.sums").write_bytes(b"precious")
    code, _, err = run("build", "scene", *QUICK, "--out", "a.scoup", "--keep-sums")
    assert (code, Path("a.scoup.sums").read_bytes()) == (2, b"precious")
    assert "--overwrite" in err


def test_smaller_region_sums():
    sizes = [
        run_json("build", "scene", *QUICK, "--out", f"{name}.scoup", "--keep-sums", *more)["sums_bytes"]
        for name, more in (("a", ()), ("b", ("--sums-weights", "float16")), ("c", ("--least-weight", "0.5")))
    ]
    assert LanguageField.load("b.scoup").info.provenance["region_sums"]["weights"] == "float16"
    assert "region_sums" not in LanguageField.load("a.scoup").info.provenance
    assert sizes[0] > sizes[1]
    assert sizes[0] > sizes[2]


def test_scaled_photographs_scale_the_cameras():
    for number in range(4):
        save_png(torch.zeros(15, 20, 3, dtype=torch.uint8), f"scene/images_2/view_0{number}.png")
    run_json("build", "scene", *QUICK, "--out", "a.scoup", "--downscale", "2")
    cameras = LanguageField.load("a.scoup").cameras
    assert cameras is not None
    assert (cameras[0].width, cameras[0].height) == (20, 15)
    shutil.rmtree("scene/images_2")  # without the folder the images are scaled
    run_json("build", "scene", *QUICK, "--out", "b.scoup", "--downscale", "2")
    assert Path("a.scoup").read_bytes() == Path("b.scoup").read_bytes()


def test_distorted_cameras_on_request():
    lines = Path("scene/sparse/0")
    shutil.rmtree(lines)
    lines.mkdir()
    lines.joinpath("cameras.txt").write_text("1 SIMPLE_RADIAL 40 30 36 20 15 0.05\n")
    lines.joinpath("images.txt").write_text("1 1 0 0 0 0 0 0 1 view_00.png\n\n")
    code, _, err = run("build", "scene", *QUICK, "--out", "a.scoup")
    assert code == 2
    assert "--undistort" in err
    assert run_json("build", "scene", *QUICK, "--out", "a.scoup", "--undistort")["views"] == 1
    assert run_json("query", "a.scoup", "kettle", "--text", "scene/words.npz", "--scene", "scene")["answers"]
    assert "scoup build needs --undistort" in run("info", "scene")[1]


def test_a_table_is_named_relative_to_the_field():
    Path("deep").mkdir()
    run_json("build", "scene", *QUICK, "--out", "deep/a.scoup", "--model", "scene/words.npz")
    assert LanguageField.load("deep/a.scoup").info.embedding_model == "../scene/words.npz"
    assert run_json("query", "deep/a.scoup", "kettle")["answers"]


def test_nothing_is_replaced_unasked():
    run_json("build", "scene", *QUICK, "--out", "a.scoup")
    before = snapshot(Path())
    code, _, err = run("build", "scene", *QUICK, "--out", "a.scoup", "--seed", "3")
    assert (code, snapshot(Path())) == (2, before)
    assert "--overwrite" in err
    run_json("build", "scene", *QUICK, "--out", "a.scoup", "--seed", "3", "--overwrite")
    assert Path("a.scoup").read_bytes() != before["a.scoup"]


@pytest.mark.parametrize("at", ["view", "after a view was added"])
@pytest.mark.parametrize("views", [0, 2, 3])
def test_an_interrupted_build_goes_on_where_it_stopped(monkeypatch, views, at):
    from scoup.uplift import region_codes
    from scoup.uplift.region_sums import RegionSums

    run_json("build", "scene", *QUICK, "--out", "whole.scoup")
    append, appended = RegionSums.append, []

    def counted(self, *view):
        if at == "view" and len(appended) == views:
            raise KeyboardInterrupt
        append(self, *view)
        appended.append(1)
        if at == "after a view was added" and len(appended) == views:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(RegionSums, "append", counted)
        code, out, err = run("build", "scene", *QUICK, "--out", "a.scoup", "--json")
    if views or at == "view":
        assert (code, err) == (130, "error: interrupted\n")
        assert out.strip() == '{\n  "error": "interrupted"\n}'
        assert not Path("a.scoup").exists()
        assert Path("a.scoup.partial").is_file()

    def no_coding(*_, **__):
        raise AssertionError("codes were learned already")

    at = ""
    with monkeypatch.context() as patch:
        if Path("a.scoup.partial").exists():
            patch.setattr(region_codes, "fit_codes", no_coding)
        patch.setattr(RegionSums, "append", counted)
        code, out, err = run("build", "scene", *QUICK, "--out", "a.scoup", "--overwrite")
    assert code == 0, err
    if views or code:
        said = f"a.scoup.partial: continues an interrupted build: {views} of 4 views are there, the codes"
        assert said in " ".join(out.split())
        assert len(appended) == 4  # each view once
    assert Path("a.scoup").read_bytes() == Path("whole.scoup").read_bytes()
    assert not Path("a.scoup.partial").exists()


def test_python_opens_what_the_command_wrote():
    run_json("build", "scene", *QUICK, "--out", "a.scoup")
    field = LanguageField.load("a.scoup")
    text = scoup.TextEncoder.open("scene/words.npz")
    assert scoup.select(field, text.encode(["kettle"])[0], text.encode(["object"])).shape == (150,)


def test_same_permissions_as_any_other_file():
    run_json("build", "scene", *QUICK, "--out", "a.scoup")
    Path("plain").write_text("x")
    assert Path("a.scoup").stat().st_mode == Path("plain").stat().st_mode
