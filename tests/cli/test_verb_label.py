"""scoup label."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from PIL import Image

from cli_support import add_words, printed, run_json
from scoup.io import load_gaussians
from scoup.query import LanguageField

pytestmark = pytest.mark.usefixtures("here")


def test_the_main_path():
    out = printed("label", "f.scoup", "kettle", "mug")
    labels = LanguageField.load("f.scoup").label(["kettle", "mug"])
    counts = labels.counts()
    assert f"kettle: {counts['kettle']} Gaussians" in out
    assert f"none of these: {counts['none']} Gaussians" in out
    assert [len(things) for things in labels.things] == [1, 1]
    assert f"kettle: {counts['kettle']} Gaussians, thing {labels.things[0][0]}\n" in out
    folder = Path("f_labels")
    classes = json.loads((folder / "labels.json").read_text())["classes"]
    assert [one["things"] for one in classes] == [list(things) for things in labels.things]
    assert {path.name for path in folder.iterdir()} == {
        "labels.npy", "labels.json", "labels.ply", "colored.ply", "labels.png",
    }  # fmt: skip
    assert len(load_gaussians(folder / "colored.ply")) == 150
    with Image.open(folder / "labels.png") as picture:
        assert picture.width == 1500


def test_an_absent_word_labels_nothing():
    texts = ("--text", add_words())
    ask = ("label", "f.scoup", "kettle", "mug", *texts, "--outputs", "sidecar")
    classes = run_json(*ask, "--out", "a", "--always")["classes"]
    low, high = sorted(classes, key=lambda one: one["score"])
    out = printed(*ask, "--out", "b", "--presence", (low["score"] + high["score"]) / 2)
    assert f"{low['name']}: not in this scene (score {low['score']:.2f})" in out.splitlines()
    assert f"{high['name']}: {high['gaussians']} Gaussians" in out
    classes = json.loads(Path("b/labels.json").read_text())["classes"]
    absent = next(one for one in classes if one["name"] == low["name"])
    assert (absent["present"], absent["gaussians"], absent["things"]) == (False, 0, [])
    assert absent["score"] == low["score"]


def test_every_output():
    outputs = ("sidecar", "ids", "colors", "glb", "clouds", "maps", "sheet")
    record = run_json("label", "f.scoup", "kettle", "mug", "--out", "all", "--outputs", *outputs)
    found = {path.relative_to("all").as_posix() for path in Path("all").rglob("*") if path.is_file()}
    assert found == set(record["files"])
    assert {"labels.glb", "clouds/kettle.ply", "clouds/none.ply", "maps/view_01.png"} <= found
    coco = json.loads(Path("all/maps/coco.json").read_text())
    assert len(coco["images"]) == 4
    assert [one["name"] for one in coco["categories"]] == ["kettle", "mug"]
    only = ("--out", "one", "--outputs", "maps", "--camera", "view_01")
    one = run_json("label", "f.scoup", "kettle", "mug", *only)
    assert set(one["files"]) == {"maps/view_01.png", "maps/coco.json"}
    assert Path("one/maps/view_01.png").read_bytes() == Path("all/maps/view_01.png").read_bytes()


def test_words_of_a_list():
    Path("words.txt").write_text("mug\n\nkettle\nmug\n")
    listed = run_json("label", "f.scoup", "--words", "words.txt", "--out", "listed", "--outputs", "sidecar")
    given = run_json("label", "f.scoup", "mug", "kettle", "--out", "given", "--outputs", "sidecar")
    assert listed["classes"] == given["classes"]
    assert [one["name"] for one in listed["classes"]] == ["mug", "kettle"]


def test_without_cameras_there_is_no_sheet():
    field = LanguageField.load("f.scoup")
    parts = (field.code_indices, field.code_weights, field.codebook, field.info, field.gaussians)
    LanguageField(*parts).save("bare.scoup")
    command = ("label", "bare.scoup", "kettle", "--text", "scene/words.npz", "--out", "a")
    assert "labels.png" not in run_json(*command)["files"]
