"""scoup select."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cli_support import QUICK, add_words, printed, refused, run, run_json
from scoup.io import load_gaussians, read_ply_table, save_gaussians, write_ply_table
from scoup.query import LanguageField, Reshaping

pytestmark = pytest.mark.usefixtures("here")


def rows(path: str) -> list[bytes]:
    return [row.tobytes() for row in read_ply_table(path).rows]


def test_the_main_path_says_what_it_chose():
    out = printed("select", "f.scoup", "kettle", "--out", "kettle.ply")
    count = len(read_ply_table("kettle.ply"))
    assert 0 < count < 150
    lines = out.splitlines()
    assert lines[::2] == [f"kettle: {count} of 150 Gaussians", f"kettle.ply: {count} Gaussians written"]
    assert re.fullmatch(r"at \[.*\], extent .*, thing \d+, presence not judged", lines[1])
    assert len(load_gaussians("kettle.ply")) == count


def test_chosen_and_rest_are_the_rows_of_the_splat_byte_for_byte():
    chosen = run_json("select", "f.scoup", "kettle", "--out", "a.ply")
    rest = run_json("select", "f.scoup", "kettle", "--out", "b.ply", "--edit", "remove")
    assert chosen["written"] == chosen["chosen"]["kettle"]
    assert chosen["written"] + rest["written"] == chosen["gaussians"] == 150
    assert sorted(rows("a.ply") + rows("b.ply")) == sorted(rows("scene/point_cloud.ply"))
    assert read_ply_table("a.ply").rows.dtype == read_ply_table("scene/point_cloud.ply").rows.dtype


def test_an_absent_text_is_said_once():
    texts = ("--text", add_words())
    both = run_json("select", "f.scoup", "kettle", "mug", *texts, "--out", "both.ply", "--always")["texts"]
    low, high = sorted(both, key=lambda text: both[text]["score"])
    scores = both[low]["score"], both[high]["score"]
    ask = ("--presence", sum(scores) / 2, *texts)
    absent = f"{low}: not in this scene (score {scores[0]:.2f})"
    out = printed("select", "f.scoup", "kettle", "mug", *ask, "--out", "a.ply")
    lines = out.splitlines()
    assert absent in lines
    assert [line for line in lines if line.startswith(f"{low}:")] == [absent]
    assert re.search(rf"^{high}: \d+ of 150 Gaussians$", out, re.MULTILINE)
    assert refused("select", "f.scoup", low, *ask, "--out", "b.ply") == (
        f"b.ply: nothing to write, 0 of 150 Gaussians answer; {absent}; --always chooses something anyway"
    )
    assert run("select", "f.scoup", low, *ask, "--out", "c.ply")[1] == ""


def test_a_thing_is_removed_and_the_field_stays():
    kept = run_json("select", "f.scoup", "kettle", "--out", "without.scoup", "--edit", "remove")
    said = run("select", "f.scoup", "kettle", "--out", "a.ply", "--edit", "remove")[1]
    assert "nothing was photographed behind it" in said
    alone = run_json("select", "f.scoup", "kettle", "--out", "kettle.scoup")
    assert kept["written"] + alone["written"] == 150
    Path("scene/point_cloud.ply").unlink()  # the Gaussians are in the files
    again = run_json("select", "kettle.scoup", "kettle", "--out", "again.ply", "--always", "--threshold", "0")
    assert again["gaussians"] == alone["written"]
    assert run_json("query", "without.scoup", "mug", "--out", "answers")["answers"]
    assert run_json("info", "without.scoup")["gaussians"] == kept["written"]
    message = refused("select", "kettle.scoup", "kettle", "--out", "kettle.scoup", "--overwrite")
    assert "is the field that is queried" in message


def test_a_selection_stays_live_in_supersplat():
    options = ("select", "f.scoup", "kettle", "-", "mug", "--grow", "1")
    record = run_json(*options, "--out", "live.ply", "--edit", "state")
    header = Path("live.ply").read_bytes().split(b"end_header")[0]
    assert header.endswith(b"property uchar state\n")
    table, before = read_ply_table("live.ply"), read_ply_table("scene/point_cloud.ply")
    assert all((table.rows[name] == before.rows[name]).all() for name in before.names)
    assert set(table.rows["state"]) == {0, 1}
    assert len(table) == record["written"] == 150
    run_json(*options, "--out", "kept.ply")
    assert before.select(table.rows["state"] == 1).rows.tobytes() == read_ply_table("kept.ply").rows.tobytes()


def test_rows_that_are_not_finite_belong_to_nobody():
    table = read_ply_table("scene/point_cloud.ply")
    data = table.rows.copy()
    data["x"][7] = np.nan
    write_ply_table(table.__class__(table.path, data), "scene/point_cloud.ply", overwrite=True)
    code, _, err = run("build", "scene", *QUICK, "--out", "a.scoup", "--model", "scene/words.npz")
    assert (code, len(err.splitlines())) == (0, 1)
    code, _, err = run("select", "a.scoup", "kettle", "--out", "live.ply", "--edit", "state")
    assert code == 0
    assert len(err.splitlines()) == 1  # one warning, though the file is read twice
    assert len(read_ply_table("live.ply")) == 150
    assert read_ply_table("live.ply").rows["state"][7] == 0
    run_json("select", "a.scoup", "kettle", "--out", "rest.ply", "--edit", "remove")
    assert np.isfinite(read_ply_table("rest.ply").rows["x"]).all()


def test_a_splat_of_another_kind_is_written_as_ply():
    save_gaussians(load_gaussians("scene/point_cloud.ply"), "g.splat")
    options = ("--gaussians", "g.splat", "--model", "scene/words.npz", "--out", "a.scoup")
    run_json("build", "scene", *QUICK, *options)
    count = run_json("select", "a.scoup", "kettle", "--out", "a.ply")["written"]
    assert len(load_gaussians("a.ply")) == count


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


def test_a_relation_that_nothing_has_says_what_was_found():
    select = ("select", "f.scoup", "mug right of the mug", "--always", "--seen-from", "view_01")
    message = refused(*select, "--out", "n.ply")
    assert re.search(r"found mug: \d+, but none that is so, as seen from view_01", message)


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


def test_recoloured_and_faded_scenes_differ_where_they_should():
    chosen = set(rows_of("kettle"))
    before = read_ply_table("scene/point_cloud.ply").rows
    found = np.array([row.tobytes() in chosen for row in before])
    colours = [name for name in before.dtype.names or () if name.startswith("f_")]
    for edit, changed in (("recolor", colours), ("fade", ["opacity"])):
        select = ("select", "f.scoup", "kettle", "--edit", edit, "--color", "#00ff00")
        record = run_json(*select, "--out", f"{edit}.ply")
        assert record["written"] == 150
        after = read_ply_table(f"{edit}.ply").rows
        for name in before.dtype.names or ():
            different = before[name] != after[name]
            assert not different[~found].any(), name
            assert different[found].any() == (name in changed), name
    recolored = read_ply_table("recolor.ply").rows
    rgb = 0.5 + 0.28209479 * np.stack([recolored[f"f_dc_{c}"][found] for c in range(3)], 1)
    assert (rgb[:, 1] > rgb[:, 0] + 0.2).all()
    assert (rgb[:, 1] > rgb[:, 2] + 0.2).all()
    paths = ("scene/point_cloud.ply", "fade.ply")
    opacities = [load_gaussians(path).opacities.numpy()[found] for path in paths]
    assert opacities[1] == pytest.approx(opacities[0] * 0.15, rel=1e-4)


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
