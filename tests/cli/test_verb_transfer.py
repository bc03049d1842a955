"""scoup transfer."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from cli_support import run, run_json, snapshot
from scoup.io import load_gaussians, save_gaussians
from scoup.query import LanguageField
from scoup.scene import Gaussians
from uplift.edits import joined

pytestmark = pytest.mark.usefixtures("here")


@pytest.fixture
def edited() -> Gaussians:
    """The scene's splat without its first five Gaussians, and with one more elsewhere."""
    splat = load_gaussians("scene")
    pasted = replace(splat, means=splat.means + 100).select([7])
    edited = joined(splat.select(slice(5, None)), pasted)
    save_gaussians(edited, "edited.ply")
    return edited


def test_codes_are_carried_over_to_an_edited_splat(edited: Gaussians) -> None:
    before = snapshot(Path())
    record = run_json("transfer", "f.scoup", "edited.ply")
    assert record == {"field": "edited.scoup", "coded": 145, "not_coded": 1}
    first, field = LanguageField.load("f.scoup"), LanguageField.load("edited.scoup")
    assert field.code_weights[:-1].equal(first.code_weights[5:])
    assert not field.code_weights[-1].any()
    assert field.gaussians.fingerprint() == edited.fingerprint()
    assert {name: part for name, part in snapshot(Path()).items() if name in before} == before
    _, out, _ = run("transfer", "f.scoup", "edited.ply", "--out", "b.scoup")
    assert "b.scoup: 145 Gaussians got codes, 1 lie in no Gaussian of f.scoup" in out


def test_an_embedded_splat_is_replaced_by_the_edited_one(edited: Gaussians) -> None:
    field = LanguageField.load("f.scoup")
    _ = field.gaussians
    field.geometry_path = None
    field.save("whole.scoup")
    run_json("transfer", "whole.scoup", "edited.ply", "--out", "b.scoup")
    Path("edited.ply").unlink()
    assert LanguageField.load("b.scoup").gaussians.fingerprint() == edited.fingerprint()
