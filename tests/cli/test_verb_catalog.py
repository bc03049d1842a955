"""scoup catalog."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest

from cli_support import WORDS, printed, run, run_json
from scoup.models import load_table, save_table
from scoup.query import LanguageField

pytestmark = pytest.mark.usefixtures("here")


def test_the_main_path():
    out = printed("catalog", "f.scoup")
    field = LanguageField.load("f.scoup")
    things = field.things()
    folder = Path("f_catalog")
    graph = json.loads((folder / "catalog.json").read_text())
    assert graph == field.catalog(field.question(WORDS)).to_dict()
    assert [one["thing"] for one in graph["things"]] == [thing.number for thing in things]
    assert f"{len(things)} things" in out
    rows = list(csv.reader((folder / "catalog.csv").read_text().splitlines()))
    assert len(rows) == len(things) + 1
    assert {"mug"} < {row[1] for row in rows[1:]} <= {"", *WORDS}
    page = (folder / "index.html").read_text()
    pictures = sorted(path.name for path in (folder / "pictures").iterdir())
    assert pictures
    assert all(f'src="pictures/{name}"' in page for name in pictures)


def test_words_of_a_list_metres_and_directions():
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
    table = load_table(Path("scene/words.npz"))
    odd = {"mug": "<script>alert(1)</script>", "kettle": "=1+1", "wooden table": "@SUM(1)"}
    names = [odd.get(name, name) for name in table.names]
    save_table(Path("odd.npz"), names, table.vectors)
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
