"""scoup query, select, label, catalog, render and compare: what is special of each."""

from __future__ import annotations

import csv
import json
import os
import re
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from cli_support import WORDS, add_words, printed, refused, run, run_json
from query.planted_room import planted_room
from query.test_named import names_of, with_names
from scoup.cli import command
from scoup.models import WordTable
from scoup.query import LanguageField
from scoup.raster import render_colors
from scoup.scene import Cameras
from scoup_lab.data.colmap_model import write_colmap
from support import make_camera, table_of

pytestmark = pytest.mark.usefixtures("here")
NO_PICTURES = ("--pictures", "none", "--overwrite")
TEXTS = ("kettle", "mug")


def pixels(path: str) -> np.ndarray:
    with Image.open(path) as picture:
        return np.asarray(picture.convert("RGB")).astype(int)


# ---- texts that are not in the scene


def scores_of(*ask: object) -> tuple[str, str, float, float]:
    """The text that answers less and the other, the score of the less one, and a bound between both."""
    found = run_json("query", "f.scoup", *TEXTS, *ask, "--always", *NO_PICTURES)["places"]
    low, high = sorted(found, key=lambda place: place["score"])
    assert low["score"] < high["score"]
    return low["text"], high["text"], low["score"], (low["score"] + high["score"]) / 2


def test_an_absent_text_has_no_place() -> None:
    words = ("--text", add_words(), "--camera", "all")
    low, high, score, bound = scores_of(*words)
    ask = ("query", "f.scoup", *TEXTS, *words, *NO_PICTURES, "--presence", bound)
    out = printed(*ask)
    assert out.count(low) == 1
    assert f"in the scene  {low}: not in this scene (score {score:.2f})" in out.splitlines()
    assert out.count(f".png  {high}: ") == 4
    record = run_json(*ask)
    place, *answers = [one for one in (*record["places"], *record["answers"]) if one["text"] == low]
    assert (place["position"], place["box"], place["gaussians"], place["things"]) == (None, None, 0, [])
    assert place["score"] == score
    assert len(answers) == 4
    for answer in answers:
        assert (answer["certainty"], answer["present"], answer["visible"]) == ("not here", False, False)
        assert (answer["pixel"], answer["box"], answer["coverage"]) == (None, None, 0)


def test_doubtful_answers_come_with_a_command(monkeypatch: pytest.MonkeyPatch) -> None:
    words = ("--text", add_words())
    low, _, score, bound = scores_of(*words)
    for likely, doubtful in ((bound, [low]), (score - 0.01, [])):
        monkeypatch.setattr("scoup.query.constants.LIKELY", likely)
        lines = [
            line
            for line in printed("query", "f.scoup", *TEXTS, *words, "--always", *NO_PICTURES).splitlines()
            if "--refine" in line
        ]
        said = f"{command('query', 'f.scoup', *doubtful, '--refine', 'owlv2')} (12 photographs: minutes on a CPU)"
        assert lines == ([f"a detector may decide what is doubtful: {said}"] if doubtful else [])


def test_an_absent_text_selects_nothing() -> None:
    words = ("--text", add_words())
    low, high, score, bound = scores_of(*words)
    ask = ("--presence", bound, *words, "--out")
    absent = f"{low}: not in this scene (score {score:.2f})"
    out = printed("select", "f.scoup", *TEXTS, *ask, "a.ply")
    assert [line for line in out.splitlines() if line.startswith(f"{low}:")] == [absent]
    assert re.search(rf"^{high}: thing \d+, \d+ of 150 Gaussians$", out, re.MULTILINE)
    assert refused("select", "f.scoup", low, *ask, "b.ply") == (
        f"b.ply: nothing to write, 0 of 150 Gaussians answer; {absent}; --always chooses something anyway"
    )


# ---- query


def test_many_texts_take_several_sheets():
    table = WordTable.load("scene/words.npz")
    names = [f"thing {number}" for number in range(7)]
    WordTable.save("many.npz", [*table.names, *names], np.concatenate([table.vectors, table.vectors]))
    record = run_json("query", "f.scoup", *names, "--text", "many.npz")
    assert record["sheets"] == ["f_queries/sheet_1.png", "f_queries/sheet_2.png"]


def test_cameras_of_another_scene():
    away = make_camera(name="away.png")
    away.viewmat[2, 3] = -1000
    write_colmap(Cameras([make_camera(64, 48, name="new.png", seed=9), away]), "other/sparse/0")
    record = run_json("query", "f.scoup", "kettle", "--scene", "other", "--camera", "all", *NO_PICTURES)
    (unseen,) = (answer for answer in record["answers"] if answer["camera"] == "away.png")
    assert (unseen["box"], unseen["visible"], unseen["present"]) == (None, False, True)
    # No photographs are needed, but it is said that there are none.
    (blind,) = (warning for warning in record["warnings"] if "image" not in warning)
    assert blind.startswith("1 of 2 cameras sees nothing of the field (away.png)")


def test_a_table_and_a_splat_named_on_the_command_line_win():
    table = WordTable.load("scene/words.npz")
    swapped = torch.from_numpy(table.vectors)[[1, 0, *range(2, len(table.names))]]
    WordTable.save("swapped.npz", table.names, swapped.numpy())
    ask = ("query", "f.scoup", *NO_PICTURES)
    mug = run_json(*ask, "mug")["answers"][0]
    shutil.move("scene/point_cloud.ply", "elsewhere.ply")
    kettle = run_json(*ask, "kettle", "--text", "swapped.npz", "--gaussians", "elsewhere.ply")["answers"][0]
    assert {**mug, "text": "kettle"} == kettle


def test_masks_for_trainers():
    options = ("--camera", "all", "--pictures", "masks", "--npz", "--out", "m")
    run_json("query", "f.scoup", *TEXTS, *options)
    run_json("label", "f.scoup", *TEXTS, "--outputs", "masks", "--out", "l")
    for camera in LanguageField.load("f.scoup").cameras or ():
        name = camera.name
        stem = name.removesuffix(".png")
        expected = np.load(f"m/{stem}/relevancy.npz")["mask"].any(0)
        with Image.open(f"m/masks/{stem}.png") as picture, Image.open(f"l/masks/{stem}.png") as labelled:
            assert (np.asarray(picture) == 255 * expected).all()
            assert set(np.unique(np.asarray(labelled))) <= {0, 255}
            assert labelled.size == picture.size


def test_python_records_and_files_say_the_same():
    options = ("--camera", "all", "--pictures", "all", "--npz", "--coco", "--out", "a")
    record = run_json("query", "f.scoup", *TEXTS, *options)
    field, kept = LanguageField.load("f.scoup"), ("sheets", "answers", "places", "frame")
    written = json.loads(Path("a/query.json").read_text())
    assert written == {"field": "f.scoup", **{key: record[key] for key in kept}}
    answers, places = field.answer(list(TEXTS)), field.location(list(TEXTS))
    for answer, place, said in zip(answers, places, record["places"], strict=True):
        assert {"text": answer.text, **place.to_dict()} == said
        assert field.location(answer).to_dict() == field.location(answer.text).to_dict() == place.to_dict()
    coco = json.loads(Path("a/coco.json").read_text())
    assert field.cameras is not None
    assert [image["file_name"] for image in coco["images"]] == list(field.cameras.names)
    areas = {(one["image_id"], one["category_id"]): one["area"] for one in coco["annotations"]}
    assert len(record["answers"]) == len(TEXTS) * len(field.cameras)
    entries = iter(record["answers"])
    for number, camera in enumerate(field.cameras):
        with np.load(f"a/{camera.stem}/relevancy.npz", allow_pickle=False) as stored:
            arrays = dict(stored)
        assert arrays["texts"].tolist() == list(TEXTS)
        assert arrays["relevancy"].dtype == np.float32
        for row, seen in enumerate(field.at(camera).show(answers)):
            files = (entry := next(entries)).pop("files")
            assert {"camera": seen.view, "text": TEXTS[row], **seen.to_dict()} == entry
            assert (seen.position is None) == (entry["position"] is None)
            assert entry["coverage"] == pytest.approx(float(seen.mask.float().mean()), abs=1e-6)
            assert (entry["score"], entry["certainty"]) == (None, None)  # too few words to judge presence
            assert np.array_equal(arrays["relevancy"][row], seen.heat.numpy())
            assert np.array_equal(arrays["mask"][row], seen.mask.numpy())
            assert (arrays["levels"][row], arrays["present"][row]) == (seen.level, seen.presence)
            assert np.isnan(arrays["score"][row])
            assert areas.get((number + 1, row + 1), 0) == int(seen.mask.sum())
            assert files.pop("npz") == f"a/{camera.stem}/relevancy.npz"
            assert (pixels(files.pop("mask"))[..., 0] == 255 * seen.mask.numpy()).all()
            assert min(len(pixels(path)) for path in files.values()) > 30  # the strip with the text


@pytest.mark.parametrize("motion", ["path", "turntable"])
def test_videos(motion, monkeypatch):
    monkeypatch.setattr("scoup.query.answer_files.FRAMES", 5)
    ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="imageio-ffmpeg is not installed")
    record = run_json("query", "f.scoup", *TEXTS, "--video", motion, "--out", "a", "--always")
    assert record["videos"] == [f"a/{text}_{motion}.mp4" for text in TEXTS]
    for path in record["videos"]:
        reader = ffmpeg.read_frames(path)
        width, height = next(reader)["size"]
        pictures = [np.frombuffer(frame, np.uint8).reshape(height, width, 3) for frame in reader]
        assert len(pictures) == 5
        assert any(np.abs(pictures[0].astype(int) - other).max() > 20 for other in pictures[1:])


# ---- catalog


def test_the_graph_is_that_of_the_field():
    out = printed("catalog", "f.scoup")
    field = LanguageField.load("f.scoup")
    folder, things = Path("f_catalog"), field.things()
    graph = json.loads((folder / "catalog.json").read_text())
    assert graph == field.catalog(field.question(WORDS)).to_dict()
    assert [one["thing"] for one in graph["things"]] == [thing.number for thing in things]
    assert f"{len(things)} things" in out
    rows = list(csv.reader((folder / "catalog.csv").read_text().splitlines()))
    assert len(rows) == len(things) + 1
    assert {"mug"} < {row[1] for row in rows[1:]} <= {"", *WORDS}
    page = (folder / "index.html").read_text()
    assert all(f'src="pictures/{path.name}"' in page for path in (folder / "pictures").iterdir())


def test_things_by_words_of_a_list():
    Path("words.txt").write_text("mug\n", "utf-16")
    record = run_json("catalog", "f.scoup", "--words", "words.txt", "--out", "c")
    named = [one for one in record["things"] if one["text"]]
    assert {one["text"] for one in named} == {"mug"}
    assert set(record["objects"]) >= {one["thing"] for one in named}


def test_names_out_of_a_list_are_escaped():
    table = WordTable.load(Path("scene/words.npz"))
    odd = {"mug": "<script>alert(1)</script>", "kettle": "=1+1", "wooden table": "@SUM(1)"}
    names = [odd.get(name, name) for name in table.names]
    WordTable.save(Path("odd.npz"), names, table.vectors)
    run_json("catalog", "f.scoup", "--text", "odd.npz", "--out", "odd")
    assert "<script>alert" not in Path("odd/index.html").read_text()
    rows = list(csv.DictReader(Path("odd/catalog.csv").read_text().splitlines()))
    assert {row["name"] for row in rows} <= {"", "<script>alert(1)</script>", "'=1+1", "'@SUM(1)"}
    assert all(not row["other names"].startswith(("=", "@")) for row in rows)
    assert any(float(row["x"]) < 0 for row in rows)  # a number stays one


@pytest.mark.skipif(sys.platform != "linux", reason="file names are of bytes")
@pytest.mark.parametrize("command", [("catalog",), ("compare", "f.scoup")])
def test_file_names_in_another_encoding_are_escaped_in_pages(command):
    name = os.fsdecode(b"<\xe9t\xe9>.scoup")
    shutil.copy("f.scoup", name)
    run_json(*command, name, "--out", "made")
    assert r"&lt;\udce9t\udce9&gt;" in Path("made/index.html").read_text("utf-8")


# ---- render


def test_colours_are_those_of_the_splat():
    printed("render", "f.scoup", "--plain")
    field = LanguageField.load("f.scoup")
    assert field.cameras is not None
    expected = render_colors(field.gaussians, field.cameras[0]).numpy() * 255
    assert np.abs(pixels("f_color/view_00.png") - expected).max() <= 1


def test_codes_of_all_cameras():
    codes = ("render", "f.scoup", "--what", "codes", "--plain")
    pictures = [pixels(file) for file in run_json(*codes, "--camera", "all")["files"]]
    assert all(picture.std() > 5 for picture in pictures)
    run_json(*codes, "--level", "s", "--out", "fine")
    assert (pixels("fine/view_00.png") != pictures[0]).any()
    run_json(*codes, "--out", "deep/a.png", "--camera", "view_01")  # one, by its name
    assert (pixels("deep/a.png") == pictures[1]).all()


@pytest.mark.parametrize("what", [(), ("--what", "codes"), ("--what", "relevancy", "--query", "kettle")])
def test_lettering_stands_around_the_plain_picture(what):
    render = ("render", "f.scoup", *what, "--scale", "3.5")
    run_json(*render, "--out", "plain.png", "--plain")
    run_json(*render, "--out", "titled.png")
    plain, titled = pixels("plain.png"), pixels("titled.png")
    assert plain.shape == (105, 140, 3)
    assert titled.shape[1] == 140
    assert any((titled[top : top + 105] == plain).all() for top in range(1, titled.shape[0] - 104))


@pytest.mark.parametrize(("name", "plain"), [("turn.webp", True), ("turn.gif", False)])
def test_an_animation(name, plain):
    shown = ("--plain",) if plain else ("--what", "relevancy", "--query", "kettle")
    run_json("render", "f.scoup", "--camera", "all", "--out", name, *shown)
    with Image.open(name) as picture:
        assert getattr(picture, "n_frames", 1) == 4
        assert (picture.size == (40, 30)) == plain
        picture.seek(1)
        picture.load()
        assert picture.info["duration"] == pytest.approx(1000 / 12, abs=4)


# ---- compare


LAMP = 4  # of planted_room.ROOM


@pytest.fixture
def captures(here: Path) -> None:
    """old.scoup, new.scoup without the lamp, and words.npz."""
    room = planted_room()
    encoder = room.encoder
    WordTable.save(Path("words.npz"), encoder.names or (), encoder.encode(list(encoder.names or ())).numpy())
    room.save("old.scoup")
    room[~table_of(room).members(torch.tensor([LAMP]))].save("new.scoup")


@pytest.mark.usefixtures("captures")
def test_an_object_that_is_gone() -> None:
    Path("t.txt").write_text("1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n")
    words = ("--text", "words.npz", "--transform", "t.txt")
    out = printed("compare", "old.scoup", "new.scoup", *words)
    agree = "scale 1: 14 of 14 things agree, residual 0"
    assert f"transform passed, {agree}" in out
    assert f"same frame, {agree}" in printed("compare", "old.scoup", "new.scoup", *words[:2], "--overwrite")
    record = json.loads(Path("new_changes/compare.json").read_text())
    (change,) = record["changes"]
    assert (change["kind"], change["old"]["text"], change["new"]) == ("removed", "lamp", None)
    page = Path("new_changes/index.html").read_text()
    for name in ("0000_new.jpg", "0000_old.jpg"):
        assert Path("new_changes/pictures", name).is_file()
        assert f'src="pictures/{name}"' in page
    assert f"removed, confidence {change['confidence']:.2f}: lamp" in out


@pytest.mark.usefixtures("captures")
def test_each_capture_answers_by_its_own_names(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []
    room = with_names(planted_room(), names_of({"lantern": {LAMP: 0.6}}))
    room.save("named.scoup")
    encoder = room.encoder
    names = list(encoder.names or ())
    vectors = encoder.encode([*names, "lamp"]).numpy()
    WordTable.save(Path("lantern.npz"), [*names, "lantern"], vectors)
    Path("lamp.txt").write_text("lamp\n")
    monkeypatch.setattr(
        "scoup.query.thing_names.thing_names", lambda _, question: seen.append(question.near) or {}
    )
    run("compare", "old.scoup", "named.scoup", "--text", "lantern.npz", "--words", "lamp.txt")
    assert seen == [(), ("lantern",)]
