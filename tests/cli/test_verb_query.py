"""scoup query."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from cli_support import add_words, printed, refused, run, run_json
from scoup.io import write_colmap
from scoup.models import load_table, save_table
from scoup.scene import Cameras
from support import make_camera

pytestmark = pytest.mark.usefixtures("here")
NO_PICTURES = ("--pictures", "none", "--overwrite")


def test_the_main_path_says_what_it_found():
    out = printed("query", "f.scoup", "kettle", "wooden table")
    lines = out.splitlines()
    seen = r"pixel \[\d+, \d+\], box \[\d+, \d+, \d+, \d+\], \d+\.\d% of the view"
    place = r"at \[.*\], extent \S+ x \S+ x \S+, thing \d+, presence not judged"
    for number, text in enumerate(("kettle", "wooden table")):
        assert re.fullmatch(rf"view_00\.png  {text}: {seen}", lines[number])
        assert re.fullmatch(rf"in the scene  {text}: {place}", lines[2 + number])
    assert lines[4:] == ["f_queries/sheet.png: the answers as pictures", "f_queries/query.json: 2 answers"]
    assert files("f_queries") == ["query.json", "sheet.png"]


def test_an_absent_text_is_said_once_and_has_no_place():
    ask = ("query", "f.scoup", "kettle", "mug", "--text", add_words(), "--camera", "all", *NO_PICTURES)
    low, high = sorted(run_json(*ask)["places"], key=lambda place: place["score"])
    assert low["score"] < high["score"]
    bound = (low["score"] + high["score"]) / 2
    out = run(*ask, "--presence", bound)[1]
    assert out.count(low["text"]) == 1
    said = f"in the scene  {low['text']}: not in this scene (score {low['score']:.2f})"
    assert said in out.splitlines()
    assert out.count(f".png  {high['text']}: ") == 4
    record = run_json(*ask, "--presence", bound)
    place, *answers = [one for one in (*record["places"], *record["answers"]) if one["text"] == low["text"]]
    assert (place["position"], place["box"], place["gaussians"], place["things"]) == (None, None, 0, [])
    assert len(answers) == 4
    for answer in answers:
        assert (answer["certainty"], answer["present"], answer["visible"]) == ("not here", False, False)
        assert (answer["pixel"], answer["box"], answer["coverage"]) == (None, None, 0)
    always = run_json(*ask, "--always")
    assert all(one["present"] and one["gaussians"] for one in always["places"])
    assert [one["score"] for one in always["places"]] == [one["score"] for one in record["places"]]


def files(folder: str) -> list[str]:
    return sorted(path.relative_to(folder).as_posix() for path in Path(folder).rglob("*.*"))


def test_the_sheet_and_single_pictures():
    ask = ("query", "f.scoup", "kettle", "wooden table", "--camera", "view_00", "--camera", "view_01")
    record = run_json(*ask, "--pictures", "all")
    singles = [
        f"view_0{number}/{name}_{kind}.png"
        for number in range(2)
        for name in ("kettle", "wooden-table")
        for kind in ("heat", "mask", "overlay")
    ]
    assert files("f_queries") == ["query.json", "sheet.png", *singles]
    named = [file for answer in record["answers"] for file in answer["files"].values()]
    assert named == [f"f_queries/{name}" for name in singles]
    assert record["sheets"] == ["f_queries/sheet.png"]
    assert "files" not in run_json(*ask, "--out", "again")["answers"][0]
    assert Path("again/sheet.png").read_bytes() == Path("f_queries/sheet.png").read_bytes()
    bare = run_json(*ask, "--out", "bare", "--pictures", "none")
    assert "files" not in bare["answers"][0]
    assert bare["sheets"] == []
    assert files("bare") == ["query.json"]


def test_many_texts_take_several_sheets():
    table = load_table("scene/words.npz")
    names = [f"thing {number}" for number in range(7)]
    save_table("many.npz", [*table.names, *names], np.concatenate([table.vectors, table.vectors]))
    record = run_json("query", "f.scoup", *names, "--text", "many.npz")
    assert record["sheets"] == ["f_queries/sheet_1.png", "f_queries/sheet_2.png"]
    assert files("f_queries") == ["query.json", "sheet_1.png", "sheet_2.png"]


def test_the_record_of_an_answer():
    record = run_json("query", "f.scoup", "kettle", "--out", "answers", "--pictures", "all")
    assert record["out"] == "answers"
    (answer,) = record["answers"]
    assert json.loads(Path("answers/query.json").read_text()) == {
        "field": "f.scoup",
        "sheets": ["answers/sheet.png"],
        "answers": [answer],
        "places": record["places"],
    }
    assert (answer["camera"], answer["text"]) == ("view_00.png", "kettle")
    assert answer["level"] in "sml"
    assert (answer["present"], answer["visible"]) == (True, True)
    assert (answer["score"], answer["certainty"]) == (None, None)  # too few words to judge presence
    assert "threshold" not in answer  # a thing answers
    (place,) = record["places"]
    assert {key: place[key] for key in ("level", "score", "present")} == {
        key: answer[key] for key in ("level", "score", "present")
    }
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
            assert picture.mode == "RGB"
            assert picture.width >= 40
            assert picture.height > 30  # the strip with the text


def test_the_unit_is_measured_by_a_side_that_is_known():
    ask = ("query", "f.scoup", "kettle", "mug", *NO_PICTURES, "--longest-side")
    record = run_json(*ask, 0.25)
    kettle, mug = record["places"]
    assert max(kettle["extent_metres"]) == pytest.approx(0.25, rel=1e-4)
    assert mug["extent_metres"] == pytest.approx(
        [side * record["metres_per_unit"] for side in mug["box"]["extent"]], rel=1e-4
    )
    assert f"--metres-per-unit {record['metres_per_unit']:.4g}" in run(*ask, 0.25)[1]
    absent = ("query", "f.scoup", "kettle", "--text", add_words(), "--presence", 1, *NO_PICTURES)
    assert "kettle: is not in the scene; name a thing that is" in refused(*absent, "--longest-side", 1)


def test_cameras_by_name_several_and_all():
    for named, views in (("", "0"), ("view_02", "2"), ("view_03.png view_01 view_03", "31"), ("all", "0123")):
        options = [part for name in named.split() for part in ("--camera", name)]
        answers = run_json("query", "f.scoup", "kettle", *NO_PICTURES, *options)["answers"]
        assert [answer["camera"] for answer in answers] == [f"view_0{number}.png" for number in views]


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
    table = load_table("scene/words.npz")
    swapped = torch.from_numpy(table.vectors)[[1, 0, *range(2, len(table.names))]]
    save_table("swapped.npz", table.names, swapped.numpy())
    ask = ("query", "f.scoup", *NO_PICTURES)
    mug = run_json(*ask, "mug")["answers"][0]
    kettle = run_json(*ask, "kettle", "--text", "swapped.npz")["answers"][0]
    assert {**mug, "text": "kettle"} == kettle
