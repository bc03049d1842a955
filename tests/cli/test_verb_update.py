"""scoup update on a small scene."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from cli_support import QUICK, run, run_json, snapshot, write_scene
from scoup.field.language_field import LanguageField
from scoup.uplift.region_sums import RegionSums

pytestmark = pytest.mark.filterwarnings("ignore:.*badly explained")  # its regions are random
VIEWS = [f"view_0{number}.png" for number in range(4)]


@pytest.fixture(autouse=True)
def _field(tmp_path, monkeypatch):
    """A field of three views of four, with its region sums."""
    monkeypatch.chdir(tmp_path)
    write_scene(Path("scene"))
    Path("later").mkdir()
    for file in Path("scene/language_features").glob("view_03*"):
        shutil.move(file, Path("later") / file.name)
    run_json("build", "scene", *QUICK, "--out", "a.scoup", "--keep-sums")


def arrive() -> None:
    """The features of the fourth view."""
    for file in Path("later").iterdir():
        shutil.copy(file, "scene/language_features")


def test_a_view_is_added_and_removed_again():
    arrive()
    before = snapshot(Path())
    added = run_json("update", "a.scoup", "--scene", "scene", "--add", "view_03", "--out", "b.scoup")
    assert (added["added"], added["removed"], added["views"]) == (["view_03.png"], [], 4)
    assert snapshot(Path())["a.scoup"] == before["a.scoup"]
    assert snapshot(Path())["a.scoup.sums"] == before["a.scoup.sums"]
    field = LanguageField.load("b.scoup")
    assert field.info.provenance["views"] == VIEWS
    assert list(RegionSums.open("b.scoup.sums").views) == VIEWS
    assert run_json("query", "b.scoup", "kettle", "--text", "scene/words.npz")["answers"]
    removed = run_json("update", "b.scoup", "--remove", "view_03.png", "--overwrite")
    assert (removed["added"], removed["views"]) == ([], 3)
    back, first = LanguageField.load("b.scoup"), LanguageField.load("a.scoup")
    assert back.code_weights.equal(first.code_weights)
    assert back.code_indices.equal(first.code_indices)


def test_all_takes_in_what_is_new_or_has_changed():
    arrive()
    features = Path("scene/language_features")
    for kind in ("s", "f"):
        shutil.copy(features / f"view_02_{kind}.npy", features / f"view_01_{kind}.npy")
    record = run_json("update", "a.scoup", "--scene", "scene", "--add", "all", "--out", "b.scoup")
    assert record["added"] == ["view_01.png", "view_03.png"]
    code, _, err = run("update", "b.scoup", "--scene", "scene", "--add", "all", "--overwrite")
    assert code == 2
    assert "nothing to do" in err


def test_new_atoms():
    arrive()
    record = run_json(
        "update", "a.scoup", "--scene", "scene", "--add", "all", "--new-atoms", "2", "--overwrite"
    )
    assert record["atoms"] in (8, 9, 10)


def test_refusals_change_nothing():
    before = snapshot(Path())
    for arguments, message in (
        ((), "say what to do"),
        (("--remove", "view_00.png"), "--overwrite"),
        (("--remove", "view_09.png", "--overwrite"), "'view_09.png' is not in the field"),
        (("--add", "all", "--overwrite"), "--scene"),
        (("--add", "view_9", "--scene", "scene", "--overwrite"), "view_9"),
        (("--remove", "view_00.png", "--out", "b.scoup", "--sums", "no.sums"), "no.sums: is not there"),
    ):
        code, _, err = run("update", "a.scoup", *arguments)
        assert code == 2, err
        assert message in err
        assert "Traceback" not in err
    assert snapshot(Path()) == before


def test_an_interrupted_update_leaves_both_files(monkeypatch):
    arrive()
    before = snapshot(Path())

    def interrupt(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("scoup.field.language_field.LanguageField.save", interrupt)
    code, _, _ = run("update", "a.scoup", "--scene", "scene", "--add", "all", "--overwrite")
    assert code == 130
    assert snapshot(Path()) == before
