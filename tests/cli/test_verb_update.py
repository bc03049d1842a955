"""scoup update on a small scene."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from cli_support import QUICK, run, run_json, snapshot, write_scene
from scoup.field.language_field import LanguageField
from scoup.io import load_gaussians, save_gaussians
from scoup.scene.gaussians import Gaussians
from scoup.uplift.region_sums import RegionSums
from uplift.edits import joined

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
    before, sums = snapshot(Path()), snapshot(Path("a.scoup.sums"))
    added = run_json("update", "a.scoup", "--scene", "scene", "--add", "view_03", "--out", "b.scoup")
    assert (added["added"], added["removed"], added["views"]) == (["view_03.png"], [], 4)
    assert snapshot(Path())["a.scoup"] == before["a.scoup"]
    assert snapshot(Path("a.scoup.sums")) == sums
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


def check_refused(*cases: tuple[tuple[str, ...], str]) -> None:
    """Each says why, and changes nothing."""
    before = snapshot(Path())
    for arguments, message in cases:
        code, _, err = run("update", "a.scoup", *arguments)
        assert code == 2, err
        assert message in err
        assert "Traceback" not in err
    assert snapshot(Path()) == before


def test_refusals_change_nothing():
    check_refused(
        ((), "say what to do"),
        (("--remove", "view_00.png"), "--overwrite"),
        (("--remove", "view_09.png", "--overwrite"), "'view_09.png' is not in the field"),
        (("--add", "all", "--overwrite"), "--scene"),
        (("--add", "view_9", "--scene", "scene", "--overwrite"), "view_9"),
        (("--remove", "view_00.png", "--out", "b.scoup", "--sums", "no.sums"), "no.sums: is not there"),
    )


def edited_splat() -> Gaussians:
    """The scene's splat without its first five Gaussians, and with one more elsewhere."""
    splat = load_gaussians("scene")
    pasted = replace(splat, means=splat.means + 100).select([7])
    edited = joined(splat.select(slice(5, None)), pasted)
    save_gaussians(edited, "edited.ply", overwrite=True)
    return edited


def test_codes_are_carried_over_to_an_edited_splat():
    before = snapshot(Path())
    edited = edited_splat()
    record = run_json("update", "a.scoup", "--edited", "edited.ply", "--out", "b.scoup")
    assert record == {"field": "b.scoup", "coded": 145, "not_coded": 1}
    first, field = LanguageField.load("a.scoup"), LanguageField.load("b.scoup")
    assert field.code_weights[:-1].equal(first.code_weights[5:])
    assert not field.code_weights[-1].any()
    assert field.gaussians.fingerprint() == edited.fingerprint()
    assert not Path("b.scoup.sums").exists()
    assert {name: part for name, part in snapshot(Path()).items() if name in before} == before
    _, out, _ = run("update", "a.scoup", "--edited", "edited.ply", "--out", "b.scoup", "--overwrite")
    assert "145 Gaussians got codes, 1 lie in no Gaussian of a.scoup" in out


def test_an_embedded_splat_is_replaced_by_the_edited_one():
    field = LanguageField.load("a.scoup")
    _ = field.gaussians
    field.geometry_path = None
    field.save("whole.scoup")
    edited = edited_splat()
    run_json("update", "whole.scoup", "--edited", "edited.ply", "--out", "b.scoup")
    Path("edited.ply").unlink()
    assert LanguageField.load("b.scoup").gaussians.fingerprint() == edited.fingerprint()


def test_sums_of_the_field_as_it_was_are_named():
    edited_splat()
    code, _, err = run("update", "a.scoup", "--edited", "edited.ply", "--overwrite")
    assert code == 0
    assert "a.scoup.sums: are region sums of another splat" in err


def test_edits_that_cannot_be_followed_change_nothing():
    edited = edited_splat()
    save_gaussians(replace(edited, means=edited.means + 1000), "other.ply")
    check_refused(
        (("--edited", "edited.ply"), "--overwrite"),
        (("--edited", "edited.ply", "--remove", "view_00.png", "--out", "b.scoup"), "takes no views"),
        (("--edited", "edited.ply", "--scene", "scene", "--out", "b.scoup"), "takes no views"),
        (("--edited", "no.ply", "--out", "b.scoup"), "no.ply"),
        (
            ("--edited", "other.ply", "--out", "b.scoup"),
            "other.ply: none of its Gaussians lies in one of the field's",
        ),
    )
