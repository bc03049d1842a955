"""scoup compare."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch

from cli_support import printed, refused, run, run_json
from query.planted_room import planted_room
from query.test_named import names_of, with_names
from scoup.models import save_table

LAMP = 4  # of planted_room.ROOM


@pytest.fixture(autouse=True)
def captures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """old.scoup, new.scoup without the lamp, and words.npz."""
    monkeypatch.chdir(tmp_path)
    room = planted_room()
    assert room.thing_table is not None
    encoder = room.encoder
    save_table(Path("words.npz"), encoder.names or (), encoder.encode(list(encoder.names or ())).numpy())
    room.save("old.scoup")
    room[~room.thing_table.members(torch.tensor([LAMP]))].save("new.scoup")


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


def test_each_capture_answers_by_its_own_names(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []
    room = with_names(planted_room(), names_of({"lantern": {LAMP: 0.6}}))
    room.save("named.scoup")
    encoder = room.encoder
    names = list(encoder.names or ())
    vectors = encoder.encode([*names, "lamp"]).numpy()
    save_table(Path("lantern.npz"), [*names, "lantern"], vectors)
    Path("lamp.txt").write_text("lamp\n")
    monkeypatch.setattr(
        "scoup.query.thing_names.thing_names", lambda _, question: seen.append(question.near) or {}
    )
    run("compare", "old.scoup", "named.scoup", "--text", "lantern.npz", "--words", "lamp.txt")
    assert seen == [(), ("lantern",)]


def test_a_splat_that_has_moved_is_named_by_the_option_of_its_capture() -> None:
    moved = planted_room()
    moved.geometry_path = Path("gone.ply")
    moved.save("moved.scoup")
    for captures, option in (("old", "moved"), "--new-gaussians"), (("moved", "old"), "--gaussians"):
        said = refused("compare", *(f"{name}.scoup" for name in captures))
        assert f"say where it is now with {option}" in said
