"""scoup select."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cli_support import QUICK, refused, run, run_json
from scoup.field.language_field import LanguageField
from scoup.io import load_gaussians, read_ply_table, save_gaussians, write_ply_table

pytestmark = pytest.mark.usefixtures("here")


def rows(path: str) -> list[bytes]:
    return [row.tobytes() for row in read_ply_table(path).rows]


def test_the_main_path_says_what_it_chose():
    code, out, err = run("select", "f.scoup", "kettle", "--out", "kettle.ply")
    assert (code, err) == (0, "")
    count = len(read_ply_table("kettle.ply"))
    assert 0 < count < 150
    assert out.splitlines() == [f"kettle: {count} of 150 Gaussians", f"kettle.ply: {count} Gaussians written"]
    assert len(load_gaussians("kettle.ply")) == count


def test_chosen_and_rest_are_the_rows_of_the_splat_byte_for_byte():
    chosen = run_json("select", "f.scoup", "kettle", "--out", "a.ply")
    rest = run_json("select", "f.scoup", "kettle", "--out", "b.ply", "--write", "rest")
    assert chosen["written"] == chosen["chosen"]["kettle"]
    assert chosen["written"] + rest["written"] == chosen["gaussians"] == 150
    assert sorted(rows("a.ply") + rows("b.ply")) == sorted(rows("scene/point_cloud.ply"))
    assert read_ply_table("a.ply").rows.dtype == read_ply_table("scene/point_cloud.ply").rows.dtype


def test_a_thing_is_removed_and_the_field_stays():
    kept = run_json("select", "f.scoup", "kettle", "--out", "without.scoup", "--write", "rest")
    alone = run_json("select", "f.scoup", "kettle", "--out", "kettle.scoup")
    assert kept["written"] + alone["written"] == 150
    Path("scene/point_cloud.ply").unlink()  # the Gaussians are in the files
    again = run_json("select", "kettle.scoup", "kettle", "--out", "again.ply", "--always", "--threshold", "0")
    assert again["gaussians"] == alone["written"]
    assert run_json("query", "without.scoup", "mug", "--out", "answers")["answers"]
    assert run_json("info", "without.scoup")["gaussians"] == kept["written"]
    message = refused("select", "f.scoup", "kettle", "--out", "ids.scoup", "--write", "ids")
    assert "no column of ids" in message
    message = refused("select", "kettle.scoup", "kettle", "--out", "kettle.scoup", "--overwrite")
    assert "is the field that is queried" in message


def test_ids_of_several_texts():
    record = run_json("select", "f.scoup", "kettle", "mug", "--out", "ids.ply", "--write", "ids")
    table = read_ply_table("ids.ply")
    ids = table.rows["selected"]
    assert table.names[-1] == "selected"
    assert len(table) == record["written"] == 150
    assert (ids == 2).sum() == record["chosen"]["mug"]
    assert 0 < (ids == 1).sum() <= record["chosen"]["kettle"]
    assert len(load_gaussians("ids.ply")) == 150
    both = run_json("select", "f.scoup", "kettle", "mug", "--out", "both.ply")
    assert both["written"] == (ids > 0).sum()


def test_rows_that_are_not_finite_belong_to_nobody():
    table = read_ply_table("scene/point_cloud.ply")
    data = table.rows.copy()
    data["x"][7] = np.nan
    write_ply_table(table.__class__(table.path, data), "scene/point_cloud.ply", overwrite=True)
    code, _, err = run("build", "scene", *QUICK, "--out", "a.scoup", "--model", "scene/words.npz")
    assert (code, len(err.splitlines())) == (0, 1)
    code, _, err = run("select", "a.scoup", "kettle", "--out", "ids.ply", "--write", "ids")
    assert code == 0
    assert len(err.splitlines()) == 1  # one warning, though the file is read twice
    assert len(read_ply_table("ids.ply")) == 150
    assert read_ply_table("ids.ply").rows["selected"][7] == 0
    rest = run("select", "a.scoup", "kettle", "--out", "rest.ply", "--write", "rest")
    assert rest[0] == 0
    assert np.isfinite(read_ply_table("rest.ply").rows["x"]).all()


def test_a_splat_of_another_kind_is_written_as_ply():
    save_gaussians(load_gaussians("scene/point_cloud.ply"), "g.splat")
    run_json(
        "build", "scene", *QUICK, "--gaussians", "g.splat", "--out", "a.scoup", "--model", "scene/words.npz"
    )
    count = run_json("select", "a.scoup", "kettle", "--out", "a.ply")["written"]
    assert len(load_gaussians("a.ply")) == count


def test_embedded_geometry_serves_where_the_file_is_damaged():
    run_json("build", "scene", *QUICK, "--out", "a.scoup", "--model", "scene/words.npz", "--embed-geometry")
    whole = run_json("select", "a.scoup", "kettle", "--out", "a.ply")["written"]
    Path("scene/point_cloud.ply").write_bytes(b"ply\n")
    assert run_json("select", "a.scoup", "kettle", "--out", "b.ply")["written"] == whole
    assert load_gaussians("b.ply").means.equal(load_gaussians("a.ply").means)


def test_thresholds_and_neighbours_change_the_choice():
    ask = ("select", "f.scoup", "kettle", "--out", "a.ply", "--overwrite")
    count = lambda *options: run_json(*ask, *options)["written"]  # noqa: E731
    assert count("--threshold", "0.1") > count("--threshold", "0.9")
    assert count("--absolute", "--threshold", "0.5") > count("--absolute", "--threshold", "0.8")
    assert count("--neighbours", "10") != count()


def test_the_threshold_is_said_and_without_one_is_the_most_stable():
    ask = ("select", "f.scoup", "kettle", "mug", "--out", "a.ply", "--overwrite")
    thresholds = lambda *options: run_json(*ask, *options)["thresholds"]  # noqa: E731
    stable = thresholds()
    assert list(stable) == ["kettle", "mug"]
    assert all(0.44 <= threshold <= 0.84 for threshold in stable.values())
    assert thresholds("--threshold", "0.55") == {"kettle": 0.55, "mug": 0.55}
    assert thresholds("--absolute", "--always") == {"kettle": 0.6, "mug": 0.6}
    field = LanguageField.load("f.scoup")
    assert field.locate("mug").record()["threshold"] == stable["mug"]


def test_nothing_to_write():
    message = refused("select", "f.scoup", "kettle", "--out", "a.ply", "--absolute", "--threshold", "1")
    assert message == "a.ply: nothing to write, 0 of 150 Gaussians answer; try a lower --threshold"


def test_the_splat_itself_is_never_replaced():
    assert "give another name" in refused(
        "select", "f.scoup", "kettle", "--out", "scene/point_cloud.ply", "--overwrite"
    )
    assert "already exists; pass --overwrite" in refused(
        "select", "f.scoup", "kettle", "--out", "scene/point_cloud.ply"
    )


def test_bad_options():
    ask = ("select", "f.scoup", "kettle", "--out")
    assert "ends in .ply" in refused(*ask, "a.splat")
    assert "--threshold must be 0 to 1" in refused(*ask, "a.ply", "--threshold", "nan")
    assert "--neighbours must be 0 or more" in refused(*ask, "a.ply", "--neighbours", "-1")
    assert "name at least one text" in refused("select", "f.scoup", "--out", "a.ply")


def test_a_level_of_ones_own():
    counts = {
        level: run_json("select", "f.scoup", "kettle", "--out", f"{level}.ply", "--level", level)["written"]
        for level in ("s", "m", "l")
    }
    field = LanguageField.load("f.scoup")
    for level, count in counts.items():
        assert count == int(field.locate("kettle", level=level).answer.mask.sum())
    assert len(set(counts.values())) > 1
    assert "there is no level 'x'" in refused("select", "f.scoup", "kettle", "--out", "x.ply", "--level", "x")
