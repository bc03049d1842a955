"""scoup query, select, label, catalog, render and compare: what is special of each."""

from __future__ import annotations

import csv
import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

from cli_support import QUICK, WORDS, add_words, printed, refused, run, run_json
from query.planted_room import planted_room
from query.test_named import names_of, with_names
from scoup.io import PlyTable, load_gaussians, write_colmap
from scoup.models import WordTable
from scoup.query import LanguageField, Reshaping
from scoup.query.edits import Edit, edited
from scoup.raster import render_colors
from scoup.scene import Cameras
from support import make_camera

pytestmark = pytest.mark.usefixtures("here")
NO_PICTURES = ("--pictures", "none", "--overwrite")
TEXTS = ("kettle", "mug")


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
    always = run_json(*ask[:-2], "--always")["places"]
    assert all(one["present"] and one["gaussians"] for one in always)


def test_an_absent_text_selects_and_labels_nothing() -> None:
    words = ("--text", add_words())
    low, high, score, bound = scores_of(*words)
    ask = ("--presence", bound, *words, "--out")
    absent = f"{low}: not in this scene (score {score:.2f})"
    out = printed("select", "f.scoup", *TEXTS, *ask, "a.ply")
    assert [line for line in out.splitlines() if line.startswith(f"{low}:")] == [absent]
    assert re.search(rf"^{high}: \d+ of 150 Gaussians$", out, re.MULTILINE)
    assert refused("select", "f.scoup", low, *ask, "b.ply") == (
        f"b.ply: nothing to write, 0 of 150 Gaussians answer; {absent}; --always chooses something anyway"
    )
    assert run("select", "f.scoup", low, *ask, "c.ply")[1] == ""
    out = printed("label", "f.scoup", *TEXTS, *ask, "b", "--outputs", "sidecar")
    assert absent in out.splitlines()
    classes = {one["name"]: one for one in json.loads(Path("b/labels.json").read_text())["classes"]}
    assert (classes[low]["present"], classes[low]["gaussians"], classes[low]["things"]) == (False, 0, [])
    assert classes[low]["score"] == score
    assert f"{high}: {classes[high]['gaussians']} Gaussians" in out
    always = run_json("label", "f.scoup", *TEXTS, *words, "--out", "a", "--outputs", "sidecar", "--always")
    assert all(one["present"] for one in always["classes"])


# ---- query


def test_the_sheet_and_single_pictures():
    ask = ("query", "f.scoup", "kettle", "wooden table", "--camera", "view_00", "--camera", "view_01")
    record = run_json(*ask, "--pictures", "all")
    assert [file for answer in record["answers"] for file in answer["files"].values()] == [
        f"f_queries/view_0{number}/{name}_{kind}.png"
        for number in range(2)
        for name in ("kettle", "wooden-table")
        for kind in ("heat", "mask", "overlay")
    ]
    assert "files" not in run_json(*ask, "--out", "again")["answers"][0]
    assert Path("again/sheet.png").read_bytes() == Path("f_queries/sheet.png").read_bytes()


def test_many_texts_take_several_sheets():
    table = WordTable.load("scene/words.npz")
    names = [f"thing {number}" for number in range(7)]
    WordTable.save("many.npz", [*table.names, *names], np.concatenate([table.vectors, table.vectors]))
    record = run_json("query", "f.scoup", *names, "--text", "many.npz")
    assert record["sheets"] == ["f_queries/sheet_1.png", "f_queries/sheet_2.png"]
    assert {path.name for path in Path("f_queries").iterdir()} == {"query.json", "sheet_1.png", "sheet_2.png"}


def test_the_record_of_an_answer():
    record = run_json("query", "f.scoup", "kettle", "--out", "answers", "--pictures", "all")
    (answer,), (place,) = record["answers"], record["places"]
    written = json.loads(Path("answers/query.json").read_text())
    assert written == {"field": "f.scoup", **{key: record[key] for key in ("sheets", "answers", "places")}}
    assert (answer["camera"], answer["text"]) == ("view_00.png", "kettle")
    assert answer["level"] in "sml"
    assert (answer["present"], answer["visible"]) == (True, True)
    assert (answer["score"], answer["certainty"]) == (None, None)  # too few words to judge presence
    assert "threshold" not in answer  # a thing answers
    assert all(place[key] == answer[key] for key in ("level", "score", "present"))
    assert len(place["things"]) == 1
    assert place["gaussians"] > 0
    assert place["runner_up"]["thing"] not in place["things"]
    mask = np.asarray(Image.open(answer["files"]["mask"]))
    assert mask.shape == (30, 40)
    assert set(np.unique(mask)) <= {0, 255}
    assert answer["coverage"] == pytest.approx((mask > 0).mean(), abs=1e-6)
    x0, y0, x1, y1 = answer["box"]
    assert 2 * (mask[y0:y1, x0:x1] > 0).sum() > (mask > 0).sum()
    for kind in ("heat", "overlay"):
        with Image.open(answer["files"][kind]) as picture:
            assert (picture.mode, picture.width >= 40) == ("RGB", True)
            assert picture.height > 30  # the strip with the text


def test_metres():
    ask = ("query", "f.scoup", *TEXTS, *NO_PICTURES)
    record = run_json(*ask, "--longest-side", 0.25)
    kettle, mug = record["places"]
    unit = record["metres_per_unit"]
    assert max(kettle["extent_metres"]) == pytest.approx(0.25, rel=1e-4)
    assert mug["extent_metres"] == pytest.approx([side * unit for side in mug["box"]["extent"]], rel=1e-4)
    assert f"--metres-per-unit {unit:.4g}" in run(*ask, "--longest-side", 0.25)[1]
    place = run_json(*ask, "--metres-per-unit", 0.5)["places"][0]
    assert place["position_metres"] == pytest.approx([0.5 * part for part in place["position"]], rel=1e-4)


def test_cameras_of_another_scene():
    away = make_camera(name="away.png")
    away.viewmat[2, 3] = -1000
    write_colmap(Cameras([make_camera(64, 48, name="new.png", seed=9), away]), "other/sparse/0")
    ask = ("query", "f.scoup", "kettle", "--scene", "other", "--camera", "all", "--json", *NO_PICTURES)
    code, out, err = run(*ask)
    assert code == 0
    record = json.loads(out)
    new, unseen = sorted(record["answers"], key=lambda answer: answer["camera"], reverse=True)
    assert (new["camera"], unseen["camera"]) == ("new.png", "away.png")
    assert (unseen["box"], unseen["visible"], unseen["present"]) == (None, False, True)
    assert "warning: 1 of 2 cameras sees nothing of the field (away.png)" in err
    # No photographs are needed, but it is said that there are none.
    assert all("image" in warning for warning in record["warnings"] if "sees nothing" not in warning)


def test_geometry_that_moved_is_named():
    shutil.move("scene/point_cloud.ply", "elsewhere.ply")
    assert run_json("query", "f.scoup", "kettle", "--gaussians", "elsewhere.ply")["answers"]


def test_the_table_named_on_the_command_line_wins():
    table = WordTable.load("scene/words.npz")
    swapped = torch.from_numpy(table.vectors)[[1, 0, *range(2, len(table.names))]]
    WordTable.save("swapped.npz", table.names, swapped.numpy())
    ask = ("query", "f.scoup", *NO_PICTURES)
    mug = run_json(*ask, "mug")["answers"][0]
    kettle = run_json(*ask, "kettle", "--text", "swapped.npz")["answers"][0]
    assert {**mug, "text": "kettle"} == kettle


def test_arrays_and_coco_hold_the_answers():
    options = ("--camera", "all", "--npz", "--coco", "--pictures", "none", "--out", "a")
    record = run_json("query", "f.scoup", *TEXTS, *options)
    assert record["sheets"] == []
    field = LanguageField.load("f.scoup")
    coco = json.loads(Path("a/coco.json").read_text())
    assert field.cameras is not None
    assert [image["file_name"] for image in coco["images"]] == list(field.cameras.names)
    areas = {(one["image_id"], one["category_id"]): one["area"] for one in coco["annotations"]}
    for number, camera in enumerate(field.cameras):
        answers = field.at(camera).answer(list(TEXTS))
        with np.load(f"a/{camera.stem}/relevancy.npz", allow_pickle=False) as arrays:
            assert arrays["texts"].tolist() == list(TEXTS)
            assert arrays["levels"].tolist() == [answer.level for answer in answers]
            assert arrays["relevancy"].dtype == np.float32
            for row, answer in enumerate(answers):
                assert np.array_equal(arrays["relevancy"][row], answer.heat.numpy())
                assert np.array_equal(arrays["mask"][row], answer.mask.numpy())
                assert arrays["present"][row] == answer.presence
                assert np.isnan(arrays["score"][row])  # too few words to judge presence
                assert areas.get((number + 1, row + 1), 0) == int(answer.mask.sum())
        entry = record["answers"][2 * number]
        assert entry["files"] == {"npz": f"a/{camera.stem}/relevancy.npz"}
    again = run_json("query", "f.scoup", *TEXTS, "--camera", "view_00", "--npz", "--out", "b")
    assert again["answers"][0]["files"]["npz"] == "b/view_00/relevancy.npz"
    assert Path("a/view_00/relevancy.npz").read_bytes() == Path("b/view_00/relevancy.npz").read_bytes()


def test_python_says_what_the_command_line_says():
    record = run_json("query", "f.scoup", *TEXTS, "--camera", "all", "--pictures", "none", "--out", "a")
    field = LanguageField.load("f.scoup")
    for number, (answer, place) in enumerate(
        zip(field.answer(list(TEXTS)), field.location(list(TEXTS)), strict=True)
    ):
        assert answer.text == TEXTS[number]
        assert {"text": answer.text, **place.to_dict()} == record["places"][number]
        assert field.location(answer).to_dict() == field.location(answer.text).to_dict() == place.to_dict()
        entries = [entry for entry in record["answers"] if entry["text"] == answer.text]
        for camera, entry in zip(field.cameras or (), entries, strict=True):
            seen = field.at(camera).show([answer])[0]
            assert {"camera": seen.view, "text": seen.text, **seen.to_dict()} == entry
            assert (seen.position is None) == (entry["position"] is None)


@pytest.mark.parametrize("motion", ["path", "turntable"])
def test_videos(motion, monkeypatch):
    monkeypatch.setattr("scoup.query.answer_files.FRAMES", 5)
    ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="imageio-ffmpeg is not installed")
    options = ("--video", motion, "--out", "a", "--always")
    record = run_json("query", "f.scoup", *TEXTS, *options)
    assert record["videos"] == [f"a/{text}_{motion}.mp4" for text in TEXTS]
    for path in record["videos"]:
        reader = ffmpeg.read_frames(path)
        width, height = next(reader)["size"]
        pictures = [np.frombuffer(frame, np.uint8).reshape(height, width, 3) for frame in reader]
        assert len(pictures) == 5
        assert any(np.abs(pictures[0].astype(int) - other).max() > 20 for other in pictures[1:])


# ---- select


def rows(path: str) -> list[bytes]:
    return [row.tobytes() for row in PlyTable.read(path).rows]


def test_chosen_and_rest_are_the_rows_of_the_splat_byte_for_byte():
    chosen = run_json("select", "f.scoup", "kettle", "--out", "a.ply")
    rest = run_json("select", "f.scoup", "kettle", "--out", "b.ply", "--edit", "remove")
    assert chosen["written"] == chosen["chosen"]["kettle"]
    assert chosen["written"] + rest["written"] == chosen["gaussians"] == 150
    assert sorted(rows("a.ply") + rows("b.ply")) == sorted(rows("scene/point_cloud.ply"))
    assert PlyTable.read("a.ply").rows.dtype == PlyTable.read("scene/point_cloud.ply").rows.dtype


def test_a_thing_is_removed_and_the_field_stays():
    kept = run_json("select", "f.scoup", "kettle", "--out", "without.scoup", "--edit", "remove")
    alone = run_json("select", "f.scoup", "kettle", "--out", "kettle.scoup")
    assert kept["written"] + alone["written"] == 150
    Path("scene/point_cloud.ply").unlink()  # the Gaussians are in the files
    again = run_json("select", "kettle.scoup", "kettle", "--out", "again.ply", "--always", "--threshold", "0")
    assert again["gaussians"] == alone["written"]
    assert run_json("query", "without.scoup", "mug", "--out", "answers")["answers"]
    assert run_json("info", "without.scoup")["gaussians"] == kept["written"]


def test_a_selection_stays_live_in_supersplat():
    options = ("select", "f.scoup", "kettle", "-", "mug", "--grow", "1")
    record = run_json(*options, "--out", "live.ply", "--edit", "state")
    header = Path("live.ply").read_bytes().split(b"end_header")[0]
    assert header.endswith(b"property uchar state\n")
    table, before = PlyTable.read("live.ply"), PlyTable.read("scene/point_cloud.ply")
    assert all((table.rows[name] == before.rows[name]).all() for name in before.names)
    assert set(table.rows["state"]) == {0, 1}
    assert len(table) == record["written"] == 150
    run_json(*options, "--out", "kept.ply")
    assert before.select(table.rows["state"] == 1).rows.tobytes() == PlyTable.read("kept.ply").rows.tobytes()


def test_rows_that_are_not_finite_belong_to_nobody():
    table = PlyTable.read("scene/point_cloud.ply")
    data = table.rows.copy()
    data["x"][7] = np.nan
    table.__class__(table.path, data).write("scene/point_cloud.ply", overwrite=True)
    code, _, err = run("build", "scene", *QUICK, "--out", "a.scoup", "--model", "scene/words.npz")
    assert (code, len(err.splitlines())) == (0, 1)
    code, _, err = run("select", "a.scoup", "kettle", "--out", "live.ply", "--edit", "state")
    assert code == 0
    assert len(err.splitlines()) == 1  # one warning, though the file is read twice
    assert len(PlyTable.read("live.ply")) == 150
    assert PlyTable.read("live.ply").rows["state"][7] == 0
    run_json("select", "a.scoup", "kettle", "--out", "rest.ply", "--edit", "remove")
    assert np.isfinite(PlyTable.read("rest.ply").rows["x"]).all()


@pytest.mark.parametrize(("splat", "out"), [("g.splat", "a.ply"), ("scene.spz", "kettle.glb")])
def test_a_field_on_a_splat_of_another_format(splat: str, out: str):
    run_json("convert", "scene", splat)
    run_json("build", "scene", *QUICK, "--gaussians", splat, "--model", "scene/words.npz", "--out", "a.scoup")
    count = run_json("select", "a.scoup", "kettle", "--out", out, "--always")["written"]
    assert len(load_gaussians(out)) == count > 0


def test_embedded_geometry_serves_where_the_file_is_damaged():
    run_json("build", "scene", *QUICK, "--out", "a.scoup", "--model", "scene/words.npz", "--embed-geometry")
    whole = run_json("select", "a.scoup", "kettle", "--out", "a.ply")["written"]
    Path("scene/point_cloud.ply").write_bytes(b"ply\n")
    assert run_json("select", "a.scoup", "kettle", "--out", "b.ply")["written"] == whole
    assert load_gaussians("b.ply").means.equal(load_gaussians("a.ply").means)


def test_things_answer_and_votes_above_a_threshold():
    ask = ("select", "f.scoup", "kettle", "mug", "--out", "a.ply", "--overwrite")
    texts = lambda *options: run_json(*ask, *options)["texts"]  # noqa: E731
    field = LanguageField.load("f.scoup")
    assert texts() == {text: field.answer(text).to_dict() for text in ("kettle", "mug")}
    assert all(one["things"] and "threshold" not in one for one in texts().values())
    for one in texts("--threshold", "0.55").values():
        assert (one["threshold"], one["things"]) == (0.55, [])
    count = lambda *options: run_json(*ask, *options)["selected"]  # noqa: E731
    assert count("--threshold", "0.3") > count("--threshold", "0.7")
    assert len({count("--level", level) for level in "sml"}) > 1


def rows_of(*texts: str) -> list[bytes]:
    run_json("select", "f.scoup", *texts, "--out", "of_text.ply", "--overwrite")
    return rows("of_text.ply")


def test_expressions_join_texts():
    both = rows_of("kettle or mug")
    assert both == rows_of("kettle", "mug")
    less = rows_of("kettle and not mug")
    assert set(less) == set(both) - set(rows_of("mug"))
    record = run_json("select", "f.scoup", "kettle", "-", "mug", "--out", "less.ply")
    assert record["expression"] == "kettle and not mug"
    assert list(record["chosen"]) == ["kettle", "mug"]
    assert record["selected"] == record["written"] < record["chosen"]["kettle"]
    assert rows("less.ply") == less
    out = run("select", "f.scoup", "kettle and not mug", "--out", "third.ply")[1]
    assert f"kettle and not mug: {record['written']}" in out.splitlines()


@pytest.mark.parametrize(("text", "options", "wanted"), [
    ("kettle", ["--grow", "1"], Reshaping(grow=1)),
    ("kettle", ["--shrink", "1"], Reshaping(shrink=1)),
    ("kettle", ["--within", "0.5"], Reshaping(within=0.5)),
    ("not kettle", ["--largest"], Reshaping(largest=True)),
])  # fmt: skip
def test_selections_are_reshaped(text, options, wanted):
    record = run_json("select", "f.scoup", text, *options, "--out", "a.ply")
    field, count = LanguageField.load("f.scoup"), len(rows("a.ply"))
    assert record["selected"] == count == int(field.select(text, wanted).mask.sum())
    assert wanted.largest or count != int(field.select(text).mask.sum())
    out = run("select", "f.scoup", text, *options, "--out", "b.ply")[1].splitlines()
    assert any(line.endswith(f": {count}") for line in out)


def test_a_shape_that_leaves_nothing_is_named():
    field = LanguageField.load("f.scoup")
    found, shape = int(field.select("kettle").mask.sum()), Reshaping(shrink=1000)
    assert field.select("kettle", shape).presence
    assert refused("select", "f.scoup", "kettle", "--shrink", 1000, "--out", "a.ply") == (
        f"a.ply: nothing to write, 0 of 150 Gaussians answer; {found} do before --shrink 1000, which leaves none; "
        "shrink less"
    )


@pytest.mark.parametrize(("edit", "options"), [
    ("recolor", {"color": (0.0, 1.0, 0.0)}), ("fade", {}), ("fade", {"opacity": 0.5}),
])  # fmt: skip
def test_scenes_are_recoloured_and_faded(edit: Edit, options: dict[str, Any]) -> None:
    given = {"color": "#00ff00"} if "color" in options else options
    more = [part for name, value in given.items() for part in (f"--{name}", value)]
    assert run_json("select", "f.scoup", "kettle", "--edit", edit, *more, "--out", "a.ply")["written"] == 150
    field = LanguageField.load("f.scoup")
    wanted, found = (
        edited(field.gaussians, field.select("kettle").mask, edit, **options),
        load_gaussians("a.ply"),
    )
    assert torch.allclose(found.sh, wanted.sh, atol=1e-6)
    assert torch.allclose(found.opacities, wanted.opacities, atol=1e-6)
    chosen = set(rows_of("kettle"))
    touched = ("f_dc", "f_rest") if edit == "recolor" else "opacity"
    before, after = PlyTable.read("scene/point_cloud.ply").rows, PlyTable.read("a.ply").rows
    for old, new in zip(before, after, strict=True):
        changed = [name for name in before.dtype.names or () if old[name] != new[name]]
        assert all(name.startswith(touched) for name in changed)
        assert bool(changed) == (old.tobytes() in chosen)


def test_a_picture_shows_before_and_after():
    select = ("select", "f.scoup", "kettle", "--edit", "remove", "--out", "a.splat", "--picture", "a.png")
    record = run_json(*select, "--metres-per-unit", "2")
    with Image.open("a.png") as picture:
        assert picture.width == 1500
        pixels = np.asarray(picture).astype(int)
    assert len(load_gaussians("a.splat")) == record["written"] == 150 - record["selected"]
    place = record["place"]
    assert place["position_metres"] == pytest.approx([2 * part for part in place["position"]], rel=1e-4)
    assert place["extent_metres"] == pytest.approx([2 * part for part in place["box"]["extent"]], rel=1e-4)
    third = pixels.shape[1] // 3
    assert np.abs(pixels[60:, 12 : third - 12] - pixels[60:, 2 * third + 12 : 3 * third - 12]).max() > 30


# ---- label


def test_labels_are_those_of_the_field():
    labels = LanguageField.load("f.scoup").label(["kettle", "mug"])
    out = printed("label", "f.scoup", "kettle", "mug")
    assert [len(things) for things in labels.things] == [1, 1]
    for text, (thing,) in zip(TEXTS, labels.things, strict=True):
        assert f"{text}: {labels.counts()[text]} Gaussians, thing {thing}\n" in out
    assert f"none of these: {labels.counts()['none']} Gaussians" in out
    classes = json.loads(Path("f_labels/labels.json").read_text())["classes"]
    assert [one["things"] for one in classes] == [list(things) for things in labels.things]
    assert len(load_gaussians("f_labels/colored.ply")) == 150
    with Image.open("f_labels/labels.png") as picture:
        assert picture.width == 1500


def test_maps_of_labels():
    label = ("label", "f.scoup", "kettle", "mug", "--outputs", "maps")
    run_json(*label, "--out", "all")
    coco = json.loads(Path("all/maps/coco.json").read_text())
    assert len(coco["images"]) == 4
    assert [one["name"] for one in coco["categories"]] == ["kettle", "mug"]
    one = run_json(*label, "--out", "one", "--camera", "view_01")
    assert set(one["files"]) == {"maps/view_01.png", "maps/coco.json"}
    assert Path("one/maps/view_01.png").read_bytes() == Path("all/maps/view_01.png").read_bytes()


def test_labels_by_words_of_a_list():
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
    pictures = [path.name for path in (folder / "pictures").iterdir()]
    assert pictures
    assert all(f'src="pictures/{name}"' in page for name in pictures)


def test_things_by_words_of_a_list_metres_and_directions():
    Path("words.txt").write_text("mug\n", "utf-16")
    options = ("--words", "words.txt", "--out", "c", "--metres-per-unit", "2", "--up", "0", "0", "1")
    record = run_json("catalog", "f.scoup", *options)
    named = [one for one in record["things"] if one["text"]]
    assert {one["text"] for one in named} == {"mug"}
    assert set(record["objects"]) >= {one["thing"] for one in named}
    one = named[0]
    assert one["position_metres"] == pytest.approx([2 * part for part in one["position"]], rel=1e-4)
    assert record["frame"]["up"] == [0, 0, 1]


def test_names_out_of_a_list_are_escaped():
    table = WordTable.load(Path("scene/words.npz"))
    odd = {"mug": "<script>alert(1)</script>", "kettle": "=1+1", "wooden table": "@SUM(1)"}
    names = [odd.get(name, name) for name in table.names]
    WordTable.save(Path("odd.npz"), names, table.vectors)
    code, _, err = run("catalog", "f.scoup", "--text", "odd.npz", "--out", "odd", "--quiet")
    assert code == 0, err
    assert "<script>alert" not in Path("odd/index.html").read_text()
    rows = list(csv.DictReader(Path("odd/catalog.csv").read_text().splitlines()))
    assert {row["name"] for row in rows} <= {"", "<script>alert(1)</script>", "'=1+1", "'@SUM(1)"}
    assert all(not row["other names"].startswith(("=", "@")) for row in rows)
    assert any(float(row["x"]) < 0 for row in rows)  # a number stays one


def test_select_takes_phrases():
    select = ("select", "f.scoup", "largest mug", "--always", "--out", "m.ply", "--seen-from", "view_01")
    code, out, err = run(*select)
    assert code == 0, err
    assert "largest mug" in out
    field = LanguageField.load("f.scoup")
    whole = field.things(field.question("mug", always=True))
    assert f"m.ply: {max(whole, key=lambda thing: thing.size).n_gaussians} Gaussians" in out


# ---- render


def pixels(path: str) -> np.ndarray:
    with Image.open(path) as picture:
        return np.asarray(picture.convert("RGB")).astype(int)


def test_colours_are_those_of_the_splat():
    printed("render", "f.scoup", "--plain")
    field = LanguageField.load("f.scoup")
    assert field.cameras is not None
    expected = render_colors(field.gaussians, field.cameras[0]).numpy() * 255
    assert np.abs(pixels("f_color/view_00.png") - expected).max() <= 1


def test_codes_of_all_cameras():
    codes = ("render", "f.scoup", "--what", "codes", "--plain")
    pictures = [pixels(file) for file in run_json(*codes, "--camera", "all")["files"]]
    assert {picture.shape for picture in pictures} == {(30, 40, 3)}
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
    film = ("--camera", "all", "--out", name)
    record = run_json("render", "f.scoup", *film, *shown)
    assert record["files"] == [name]
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
    assert room.thing_table is not None
    encoder = room.encoder
    WordTable.save(Path("words.npz"), encoder.names or (), encoder.encode(list(encoder.names or ())).numpy())
    room.save("old.scoup")
    room[~room.thing_table.members(torch.tensor([LAMP]))].save("new.scoup")


@pytest.mark.usefixtures("captures")
def test_an_object_that_is_gone() -> None:
    Path("t.txt").write_text("1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n")
    words = ("--text", "words.npz", "--transform", "t.txt")
    out = printed("compare", "old.scoup", "new.scoup", *words)
    record = json.loads(Path("new_changes/compare.json").read_text())
    (change,) = record["changes"]
    assert (change["kind"], change["old"]["text"], change["new"]) == ("removed", "lamp", None)
    page = Path("new_changes/index.html").read_text()
    pictures = sorted(path.name for path in Path("new_changes/pictures").iterdir())
    assert pictures == ["0000_new.jpg", "0000_old.jpg"]
    assert all(f'src="pictures/{name}"' in page for name in pictures)
    assert f"removed, confidence {change['confidence']:.2f}: lamp" in out
    other = run_json("compare", "new.scoup", "old.scoup", *words, "--out", "back")
    assert [one["kind"] for one in other["changes"]] == ["added"]


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


@pytest.mark.usefixtures("captures")
def test_a_splat_that_has_moved_is_named_by_the_option_of_its_capture() -> None:
    moved = planted_room()
    moved.geometry_path = Path("gone.ply")
    moved.save("moved.scoup")
    for captures, option in (("old", "moved"), "--new-gaussians"), (("moved", "old"), "--gaussians"):
        said = refused("compare", *(f"{name}.scoup" for name in captures))
        assert f"say where it is now with {option}" in said
