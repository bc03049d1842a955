"""scoup frame: the ways to a metre, what keeps it, and that all verbs answer in it."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path
from typing import Any

import pytest
import torch

from cli_support import BUILD, QUICK, add_words, printed, refused, run_json
from scoup.archive import Archive
from scoup.base import WorldFrame
from scoup.field import Field, read_facts
from scoup.io import load_gaussians, save_gaussians
from scoup.query import LanguageField

pytestmark = pytest.mark.usefixtures("here")
WORLD = WorldFrame(0.5, (0.0, 0.0, -1.0), (0.0, 1.0, 0.0), (48.2, 16.4, 180.0), "map")
ALL = [
    "--metres-per-unit", "0.5", "--up", "-z", "--north", "0", "1", "0", "--origin", "48.2", "16.4", "180", "--name",
    "map",
]  # fmt: skip


def frame_of(path: str = "f.scoup") -> WorldFrame:
    return LanguageField.load(path).world


def set_frame(*options: object) -> dict[str, Any]:
    return run_json("frame", "f.scoup", *options)["frame"]


def test_each_part_is_written_and_what_is_not_passed_stays() -> None:
    before = Path("f.scoup").read_bytes()
    assert set_frame() == WorldFrame().to_dict()
    assert Path("f.scoup").read_bytes() == before, "printing changes nothing"
    assert "scene units" in printed("frame", "f.scoup")
    for options in (ALL[:2], ALL[2:4], ALL[4:8], ALL[8:12], ALL[12:]):
        set_frame(*options)
    assert frame_of() == WORLD
    assert set_frame("--up", 3, 0, 4)["up"] == [0.6, 0, 0.8]
    assert frame_of().metres_per_unit == 0.5
    lines = printed("frame", "f.scoup").splitlines()
    assert lines == [
        "metres per unit: 0.5",
        "up: 0.6, 0, 0.8",
        "north: 0, 1, 0",
        "origin: 48.2, 16.4, 180",
        "name: map",
    ]


def test_a_known_size_measures_the_unit() -> None:
    """Also with an up of the same command, which turns boxes."""
    unit = set_frame("--thing", "kettle", "--longest-side", 0.25, "--up", "x")["metres_per_unit"]
    box = LanguageField.load("f.scoup").location("kettle").box
    assert box is not None
    assert float(box.extent.max()) * unit == pytest.approx(0.25)


def test_a_known_distance_measures_the_unit() -> None:
    unit = set_frame("--thing", "kettle", "--other", "mug", "--distance", 2)["metres_per_unit"]
    one, two = (LanguageField.load("f.scoup").location(text).position for text in ("kettle", "mug"))
    assert one is not None
    assert two is not None
    assert float((one - two).norm()) * unit == pytest.approx(2)


def test_a_doubtful_or_absent_thing_measures_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    words = add_words()
    score = LanguageField.load("f.scoup", words=words).answer("kettle").score
    assert score is not None
    measure = "frame", "f.scoup", "--thing", "kettle", "--longest-side", 1, "--text", words
    for least, wanted in ((score + 0.01, "not in this scene"), (0.0, "doubtful")):
        monkeypatch.setattr("scoup.query.constants.PRESENT_FROM", least)
        monkeypatch.setattr("scoup.query.constants.LIKELY", 1.01)
        assert wanted in refused(*measure)
    assert frame_of() == WorldFrame()


def test_a_file_keeps_its_tensors_and_older_readers_its_header() -> None:
    field = Field.load("f.scoup")
    field.save("bits.scoup", weight_bits=8, embed_geometry=True)
    before = LanguageField.load("bits.scoup")
    size = Path("bits.scoup").stat().st_size
    run_json("frame", "bits.scoup", *ALL)
    after, facts = LanguageField.load("bits.scoup"), read_facts(Path("bits.scoup"))
    assert 0 < Path("bits.scoup").stat().st_size - size < 400
    assert torch.equal(before.code_weights, after.code_weights)
    assert (after.world, facts["frame"]["name"]) == (WORLD, "map")
    assert after.gaussians.world == WORLD, "exports have it"
    after.with_world(WorldFrame()).save("plain.scoup", weight_bits=8, embed_geometry=True)
    before.save("again.scoup", weight_bits=8, embed_geometry=True)
    assert Path("plain.scoup").read_bytes() == Path("again.scoup").read_bytes(), (
        "without a frame nothing is written"
    )


def test_building_transferring_and_cutting_keep_it() -> None:
    set_frame(*ALL)
    save_gaussians(load_gaussians("scene/point_cloud.ply").select(slice(3, None)), "edited.ply")
    run_json("transfer", "f.scoup", "edited.ply")
    run_json("select", "f.scoup", "kettle", "--out", "kettle.scoup")
    assert frame_of("edited.scoup") == frame_of("kettle.scoup") == WORLD
    shutil.copy("f.scoup", "a.scoup")
    run_json(*BUILD, "--overwrite", "--k", 2)
    assert frame_of("a.scoup") == WORLD
    save_gaussians(load_gaussians("edited.ply"), "scene/point_cloud.ply", overwrite=True)
    run_json(*BUILD, "--overwrite")
    assert frame_of("a.scoup") == WorldFrame(), "of other Gaussians"


def test_a_splat_with_a_place_on_earth_gives_its_field_one() -> None:
    run_json("frame", "f.scoup", *ALL)
    run_json("select", "f.scoup", "kettle", "--edit", "fade", "--out", "whole.spz")
    run_json("convert", "whole.spz", "again.spz")
    run_json("build", "scene", *QUICK, "--gaussians", "again.spz", "--out", "b.scoup", "--no-check-fit")
    found = frame_of("b.scoup")
    assert (found.metres_per_unit, found.up) == (0.5, pytest.approx(WORLD.up, abs=1e-9))
    assert found.origin == pytest.approx(WORLD.origin, abs=1e-6)


VERBS = {
    "query f.scoup kettle --pictures none": lambda record: record["places"],
    "select f.scoup kettle --out a.ply": lambda record: [record["place"]],
    "catalog f.scoup": lambda record: record["things"],
    "archive scans --add f.scoup": lambda record: [
        thing.to_dict() for thing in Archive("scans").find("kettle")
    ],
}


@pytest.mark.parametrize("verb", VERBS)
def test_verbs_answer_in_metres(verb: str) -> None:
    plain = VERBS[verb](run_json(*verb.split()))
    shutil.rmtree("scans", ignore_errors=True)
    set_frame(*ALL)
    record = run_json(*verb.split(), "--overwrite") if verb[0] != "a" else run_json(*verb.split())
    assert plain
    assert not any("position_metres" in each for each in plain)
    for each in VERBS[verb](record):
        for name, units in (("position", each["position"]), ("extent", each["box"]["extent"])):
            assert each[f"{name}_metres"] == pytest.approx([0.5 * value for value in units], abs=1e-5)
        assert abs(each["box"]["axes"][2][2]) == 1, "boxes stand upright"
    if "frame" in record:
        assert (record["frame"]["metres_per_unit"], record["frame"]["name"]) == (0.5, "map")


def test_texts_pages_tables_and_labels_are_in_metres() -> None:
    ask = "query", "f.scoup", "kettle", "--pictures", "none", "--overwrite"
    assert " scene units, presence" in printed(*ask)
    before = run_json("catalog", "f.scoup")
    set_frame(*ALL)
    assert "scene units" not in printed(*ask)
    run_json("catalog", "f.scoup", "--overwrite")
    run_json("label", "f.scoup", "kettle")
    page, labels = Path("f_catalog/index.html").read_text(), Path("f_labels/labels.json").read_text()
    assert " scene units" not in page
    assert " m<br>" in page
    assert json.loads(labels)["frame"] == WORLD.to_dict()
    one = before["things"][0]
    rows = csv.DictReader(Path("f_catalog/catalog.csv").read_text().splitlines())
    (place,) = (float(row["x"]) for row in rows if row["thing"] == str(one["thing"]))
    assert place == pytest.approx(0.5 * one["position"][0], abs=1e-4)
    run_json("compare", "f.scoup", "f.scoup")


def test_within_is_in_metres() -> None:
    def count(within: float) -> int:
        options = "--within", within, "--out", "a.ply", "--overwrite"
        return run_json("select", "f.scoup", "kettle", *options)["written"]

    plain = [count(within) for within in (0, 0.4, 0.8)]
    assert plain[0] < plain[1] < plain[2]
    set_frame(*ALL)
    assert [count(within) for within in (0, 0.2, 0.4)] == plain
