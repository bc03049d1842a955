"""A phrase gives the same things wherever it is asked: three verbs, the live page, and agents."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("starlette", reason="needs scoup[view]")
from starlette.testclient import TestClient
from view_samples import PAGE

from cli_support import run, run_json
from query.planted_room import ABSENT, FRONT, ROOM, Box, planted_room
from scoup.models import WordTable
from scoup.query import LanguageField
from scoup.view.guard import Guard
from scoup.view.scene_tools import SceneTools
from scoup.view.server import application
from scoup.view.viewed_field import ViewedField
from support import altered

TABLE, LEFT, RIGHT, LAPTOP, LAMP, BALL, BOWL, APPLE, PEN, SALT = range(10)
MUGS = {LEFT, RIGHT}
ON_TABLE = {*MUGS, LAPTOP, BOWL, SALT}  # the pen hangs a little above it
PHRASES: dict[str, set[int]] = {
    "mug": MUGS, "the mug": MUGS, "Mugs": MUGS, '"mugs"': MUGS, "pens": {PEN},
    "the mugs on the table?": MUGS, "laptops": {LAPTOP},
    "mug left of the laptop": {LEFT}, "the mug to the left of the laptop": {LEFT},
    "mug that is right of the laptop": {RIGHT}, "mugs on the table": MUGS,
    "what is on the table": ON_TABLE, "What is on the table?": ON_TABLE, "things on the table": ON_TABLE,
    "what is inside the bowl": {APPLE}, "everything under the table": {BALL},
    "largest thing on the table": {BOWL}, "ball under the table": {BALL},
    "largest mug": {RIGHT}, "the second largest mug": {LEFT}, "second mug from the left": {RIGHT},
    "mug nearest to the pen": {RIGHT}, "laptop between mug and mug": {LAPTOP},
    "mug or laptop": {*MUGS, LAPTOP}, "mug and not mug left of the laptop": {RIGHT},
    "(mug or pen) and not (mug behind laptop)": {LEFT, PEN}, "mugs or laptops": {*MUGS, LAPTOP},
    "(mugs or bowls) and not mug left of the laptop": {RIGHT, BOWL},
    "mugs on the table or balls on the table": MUGS, "mugs on the table and right of the laptop": {RIGHT},
    "mug on the table and not right of the laptop": {LEFT},
    "Salt and pepper": {SALT}, "salt and pepper on the table": {SALT},
    "the mug nearest to the Salt and Pepper": {RIGHT}, "mugs or salt and pepper": {*MUGS, SALT},
    'mug nearest to "salt and pepper"': {RIGHT},
    "mug and laptop": set(), "mug near the laptop": set(), "laptop right of the lamp": set(),
    ABSENT: set(), f"mug left of the {ABSENT}": set(), f"(mug and laptop) and not {ABSENT}": set(),
}  # fmt: skip


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A saved field of the room, with its word table."""
    folder = tmp_path_factory.mktemp("room")
    field = planted_room((*ROOM, Box("salt and pepper", (1.5, -0.5, 1.1), (0.2, 0.2, 0.2))))
    encoder = field.encoder
    assert encoder.names is not None
    WordTable.save(folder / "words.npz", encoder.names, encoder.encode(encoder.names).numpy())
    info = replace(field.info, embedding_model="some/model", words=folder / "words.npz")
    altered(field, info=info).save(folder / "room.scoup")
    return folder / "room.scoup"


@pytest.fixture(scope="module")
def said(path: Path) -> dict[str, dict[str, dict[str, Any]]]:
    """What query, label, page and agents say of each phrase."""
    out = path.parent
    query = run_json("query", path, *PHRASES, "--pictures", "none", "--out", out / "answers")
    label = run_json("label", path, *PHRASES, "--outputs", "sidecar", "--out", out / "labels")
    field = LanguageField.load(path)
    app = application(ViewedField(field), PAGE, Guard.of("127.0.0.1"))
    client, tools = TestClient(app, "http://127.0.0.1:8350"), SceneTools({"room": field})
    page = [
        answer
        for some in zip(*[iter(PHRASES)] * 3, strict=True)
        for answer in client.post("/api/query", json={"texts": some}).json()["answers"]
    ]
    agents = [tools.find("room", text) for text in PHRASES]
    places = {"query": query["places"], "label": label["classes"], "page": page, "agents": agents}
    return {name: dict(zip(PHRASES, answers, strict=True)) for name, answers in places.items()}


def test_a_phrase_gives_the_same_things_in_five_places(path: Path, said, tmp_path: Path) -> None:
    for number, (text, found) in enumerate(PHRASES.items()):
        query, label, page, agents = (said[place][text] for place in ("query", "label", "page", "agents"))
        select = ("select", path, text, "--out", tmp_path / f"{number}.ply")
        if found:
            assert set(run_json(*select)["place"]["things"]) == found, text
        else:
            code, _, problem = run(*select)
            assert (code, "nothing to write" in problem) == (2, True), text
        assert set(query["things"]) == set(label["things"]) == found, text
        assert (page["present"], query["present"], label["present"]) == (bool(found),) * 3, text
        assert (set(page["chosen_things"]) if found else set()) == found, text
        assert page["text"] == text
        assert {thing["thing"] for thing in agents["things"]} == found, text


def test_answers_say_what_was_found_and_from_where(path: Path, said, tmp_path: Path) -> None:
    text = "laptop right of the lamp"
    found = "found laptop: 1, lamp: 1, but none that is so, as seen from front.png"
    assert found in run("select", path, text, "--out", tmp_path / "a.ply")[2]
    assert said["page"][text]["remark"] == said["agents"][text]["remark"] == found
    remarks = {text: answer["remark"] for text, answer in said["page"].items()}
    assert remarks["what is on the table"].startswith("2 x mug, laptop, bowl, salt and pepper; sure")
    assert remarks["mug"] is None
    assert remarks["mugs or laptops"].startswith("2 x mug, laptop; sure")
    without = remarks[f"(mug and laptop) and not {ABSENT}"]
    assert without == "found mug: 2, laptop: 1, but none that is so", "what must not be there is not missed"
    assert remarks[f"mug left of the {ABSENT}"].startswith(f"{ABSENT}: not in this scene")
    # Left and right are seen from one camera, which answers name.
    text = "mug left of the laptop"
    assert said["query"][text]["seen_from"] == FRONT.name
    assert f"as seen from {FRONT.name}" in remarks[text]
    assert FRONT.name in said["agents"][text]["directions"]
    assert "seen_from" not in said["query"]["mugs on the table"]
    options = ("--pictures", "none", "--seen-from", "back", "--out", tmp_path / "back")
    other = run_json("query", path, text, *options)["places"][0]
    assert (other["things"], other["seen_from"]) == ([RIGHT], "back.png")
