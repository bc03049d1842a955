"""scoup select and label: what is special of each."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

from cli_support import QUICK, printed, refused, run_json, warned
from scoup.io import PlyTable, load_gaussians
from scoup.query import LanguageField, Reshaping
from scoup.query.edits import Edit, edited

pytestmark = pytest.mark.usefixtures("here")
TEXTS = ("kettle", "mug")


def rows(path: str) -> list[bytes]:
    return [row.tobytes() for row in PlyTable.read(path).rows]


def test_chosen_and_rest_are_the_rows_of_the_splat_byte_for_byte():
    chosen = run_json("select", "f.scoup", "kettle", "--out", "a.ply")
    rest = run_json("select", "f.scoup", "kettle", "--out", "b.ply", "--edit", "remove")
    assert chosen["written"] == chosen["chosen"]["kettle"] == 150 - rest["written"]
    assert sorted(rows("a.ply") + rows("b.ply")) == sorted(rows("scene/point_cloud.ply"))


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
    run_json("build", "scene", *QUICK, "--out", "a.scoup", "--model", "scene/words.npz")
    err = warned("select", "a.scoup", "kettle", "--out", "live.ply", "--edit", "state")
    assert len(err.splitlines()) == 1  # one warning, though the file is read twice
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


def test_things_answer_and_votes_above_a_threshold():
    ask = ("select", "f.scoup", *TEXTS, "--out", "a.ply", "--overwrite")
    field = LanguageField.load("f.scoup")
    assert run_json(*ask)["texts"] == {text: field.answer(text).to_dict() for text in TEXTS}
    for one in run_json(*ask, "--threshold", "0.55")["texts"].values():
        assert (one["threshold"], one["things"]) == (0.55, [])
    assert len({run_json(*ask, "--level", level)["selected"] for level in "sml"}) > 1


def test_expressions_join_texts():
    record = run_json("select", "f.scoup", "kettle", "-", "mug", "--out", "a.ply")
    assert record["expression"] == "kettle and not mug"
    assert list(record["chosen"]) == ["kettle", "mug"]
    assert record["selected"] == record["written"] < record["chosen"]["kettle"]
    out = printed("select", "f.scoup", "kettle and not mug", "--out", "b.ply")
    assert f"kettle and not mug: {record['written']}" in out.splitlines()
    assert rows("a.ply") == rows("b.ply")
    for name, texts in (("c", ["kettle or mug"]), ("d", TEXTS)):
        run_json("select", "f.scoup", *texts, "--out", f"{name}.ply")
    assert rows("c.ply") == rows("d.ply")


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


def test_a_shape_that_leaves_nothing_is_named():
    found = int(LanguageField.load("f.scoup").select("kettle").mask.sum())
    assert refused("select", "f.scoup", "kettle", "--shrink", 1000, "--out", "a.ply") == (
        f"a.ply: nothing to write, 0 of 150 Gaussians answer; {found} do before --shrink 1000, which leaves none; "
        "shrink less"
    )


@pytest.mark.parametrize(("edit", "options"), [
    ("recolor", {"color": (0.2, 0.4, 1.0)}), ("fade", {}), ("fade", {"opacity": 0.5}),
])  # fmt: skip
def test_scenes_are_recoloured_and_faded(edit: Edit, options: dict[str, Any]) -> None:
    given = {"color": "#3366ff"} if "color" in options else options
    more = [part for name, value in given.items() for part in (f"--{name}", value)]
    assert run_json("select", "f.scoup", "kettle", "--edit", edit, *more, "--out", "a.ply")["written"] == 150
    field = LanguageField.load("f.scoup")
    wanted = edited(field.gaussians, field.select("kettle").mask, edit, **options)
    found = load_gaussians("a.ply")
    assert torch.allclose(found.sh, wanted.sh, atol=1e-6)
    assert torch.allclose(found.opacities, wanted.opacities, atol=1e-6)


def test_a_picture_shows_before_and_after():
    select = ("select", "f.scoup", "kettle", "--edit", "remove", "--out", "a.splat", "--picture", "a.png")
    record = run_json(*select)
    with Image.open("a.png") as picture:
        pixels = np.asarray(picture).astype(int)
    assert len(load_gaussians("a.splat")) == record["written"] == 150 - record["selected"]
    third = pixels.shape[1] // 3
    assert np.abs(pixels[60:, 12 : third - 12] - pixels[60:, 2 * third + 12 : 3 * third - 12]).max() > 30


# ---- label


def test_labels_by_words_of_a_list_and_maps_of_one_camera():
    Path("words.txt").write_text("mug\n\nkettle\nmug\n")
    label = ("label", "f.scoup", "--outputs", "sidecar", "maps", "--out")
    listed = run_json(*label, "listed", "--words", "words.txt")
    assert [one["name"] for one in listed["classes"]] == ["mug", "kettle"]
    labels = LanguageField.load("f.scoup").label(["mug", "kettle"])
    assert [one["things"] for one in listed["classes"]] == [list(answer.things) for answer in labels.answers]
    given = run_json("label", "f.scoup", "mug", "kettle", *label[2:], "given", "--camera", "view_01")
    assert given["classes"] == listed["classes"]
    assert {"maps/view_01.png", "maps/coco.json"} == {file for file in given["files"] if "maps" in file}
    assert Path("given/maps/view_01.png").read_bytes() == Path("listed/maps/view_01.png").read_bytes()


def test_without_cameras_there_is_no_sheet():
    field = LanguageField.load("f.scoup")
    parts = (field.code_indices, field.code_weights, field.codebook, field.info, field.gaussians)
    LanguageField(*parts).save("bare.scoup")
    command = ("label", "bare.scoup", "kettle", "--text", "scene/words.npz", "--out", "a")
    assert "labels.png" not in run_json(*command)["files"]
