"""Phrases in an exported page: its program answers them as Python does, in a browser and without one."""

from __future__ import annotations

import json
import random
import shutil
from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("starlette", reason="needs scoup[view]")
from test_one_grammar import PHRASES
from view_samples import PAGE

from children import PIPE, child
from query.planted_room import ABSENT, ROOM, Box, planted_room, with_whole
from scoup.base import ScoupError
from scoup.query import LanguageField
from scoup.view import export
from scoup.view.export import export_page
from scoup.view.viewed_field import ViewedField

VIEWER = Path(__file__).resolve().parents[2] / "viewer"
REFUSED = (
    "mug left of", "mug near", "left of the laptop", "the largest", "mug across the table", "mug between laptop",
    "second mug", "second mug from the side", "mug and", "not", "(mug", "mug)", "mug (laptop)", '"mug',
    "mug or and pen", "spoon", "mug on the spoon", "largest spoon", "what is near", "mug" + " on the mug" * 9,
)  # fmt: skip
UNUSUAL = (
    "not mug", "mug and not (not pen)", "mug - pen", "mug + pen or laptop", "first mug", "mug, left of the laptop.",
    "mug in between the bowl and the pen and not under the lamp", '"left of" or mug', "MUG ON THE TABLE",
    "the 2nd smallest thing on the table", "what's near the pen", "things nearest to the lamp", "mug from the right",
    "mug or mugs", "mugs or mug nearest to the pen", "mug and (near the laptop or near the pen)",
    "(mug on the table) and near the pen or near the bowl", "mug that is",
)  # fmt: skip
HALL = (
    Box("shelf", (6, 0, 0.75), (0.4, 0.4, 1.5)), Box("book", (6, 0, 0.3), (0.3, 0.3, 0.3)),  # at its lower end
    Box("desk", (8, 0, 0.95), (2, 2, 0.1)), Box("cup", (8.2, 0.1, 1.4), (0.2, 0.2, 0.2)),  # which hangs over it
    Box("stone", (11, 0, 1), (0.1, 0.1, 0.1)), Box("coin", (11.6, 0, 1), (0.1, 0.1, 0.1)),
    Box("wall", (11, 2.1, 1), (0.4, 4, 2)),  # nearer to the stone than the coin, but for its middle
)  # fmt: skip
IN_HALL: dict[str, set[int]] = {
    "book above shelf": {1}, "book on shelf": {1}, "shelf under book": {0}, "shelf above book": set(),
    "book under shelf": set(), "cup above desk": {3}, "cup on desk": set(), "desk under cup": {2},
    "what is nearest to the stone": {6}, "coin nearest to the stone": {5}, "coin or wall near stone": {5, 6},
    "desk between shelf and coin": {2}, "what is between book and wall": {2, 3}, "what is above the desk": {3},
}  # fmt: skip


def room(levels: int) -> LanguageField:
    """The room of all phrases; at a second level, a mug and the laptop are one thing with the pen."""
    boxes = (*ROOM, Box("salt and pepper", (1.5, -0.5, 1.1), (0.2, 0.2, 0.2)))
    return planted_room(boxes) if levels == 1 else with_whole(planted_room(boxes), [1, 3, 8])[0]


def random_phrases(count: int) -> list[str]:
    """Nested phrases of all relations and orders; some lack a part."""
    draw = random.Random(7)
    names = ["mug", "laptops", "the pen", "Bowl", '"apple"', "lamp", "table", "salt and pepper", ABSENT]
    relations = [
        "left of", "to the right of", "in front of", "behind", "on", "above", "beneath", "next to", "in",
    ]  # fmt: skip
    relations += ["closest to", "between", "inside of", "facing"]
    before = ["", "", "", "largest ", "second smallest ", "the 2nd biggest "]

    def phrase(depth: int) -> str:
        noun = draw.choice([draw.choice(before) + draw.choice(names), "what is", "everything"])
        noun += draw.choice(["", "", "", " from the left", " from the top", " from the back", " that is"])
        if depth > 2 or draw.random() < 0.4:
            return noun
        relation = draw.choice(relations)
        second = f" and {phrase(depth + 1)}" if relation == "between" else ""
        return f"{noun} {relation} {phrase(depth + 1)}{second}"

    def expression() -> str:
        joined = draw.choice([" and ", " or ", " - ", " and not ", f" and {draw.choice(relations)} "])
        one, other = phrase(1), phrase(1)
        return draw.choice([phrase(0), one + joined + other, f"({one}){joined}{other}", f"not {one}"])

    return [expression() for _ in range(count)]


def by_python(viewed: ViewedField, text: str) -> dict[str, Any]:
    try:
        return viewed.answers([text])[0].to_dict()
    except ScoupError as error:
        return {"refused": str(error)}


def check_alike(viewed: ViewedField, texts: Sequence[str], answers: Sequence[dict[str, Any]]) -> None:
    """Compare the answers of a page with those of Python, and what is refused."""
    for text, answer in zip(texts, answers, strict=True):
        wanted = by_python(viewed, text)
        assert ("refused" in answer) == ("refused" in wanted), (text, answer, wanted)
        if "refused" in wanted:
            continue
        for name in (
            "text",
            "certainty",
            "present",
            "gaussians",
            "remark",
            "level",
            "chosen_things",
            "things",
            "without",
        ):
            assert answer[name] == wanted[name], (text, name)
        assert answer["score"] == (None if wanted["score"] is None else pytest.approx(wanted["score"])), text
        assert (answer["runner_up"] or {}).get("thing") == (wanted["runner_up"] or {}).get("thing"), text


@pytest.fixture
def by_page(tmp_path: Path, monkeypatch) -> Callable[[ViewedField, Sequence[str]], list[dict[str, Any]]]:
    """Return what the program of an exported page answers, without a browser."""
    node, script = shutil.which("node"), Path(__file__).with_name("ask_exported.mjs")
    if node is None or not (VIEWER / "node_modules" / "esbuild").is_dir():
        pytest.skip("needs node and the packages of viewer/: npm ci")
    monkeypatch.setattr(export, "page_files", lambda: PAGE)

    def ask(viewed: ViewedField, texts: Sequence[str]) -> list[dict[str, Any]]:
        page = tmp_path / "page.html"
        export_page(viewed, page)
        command = [node, str(script), str(VIEWER), str(page)]
        with child(command, stdin=PIPE) as process:
            out, err = process.communicate(json.dumps(texts))
        assert process.returncode == 0, err
        return json.loads(out)

    return ask


def test_relations_that_hardly_hold_are_the_same(by_page) -> None:
    viewed = ViewedField(planted_room(HALL))
    answers = by_page(viewed, list(IN_HALL))
    check_alike(viewed, list(IN_HALL), answers)
    found = [set(answer["chosen_things"]) if answer["present"] else set() for answer in answers]
    assert dict(zip(IN_HALL, found, strict=True)) == IN_HALL


def test_parts_of_one_thing_are_told_apart(by_page, monkeypatch) -> None:
    """A ball and its bowl are one thing at the coarser level, which is made to answer here."""
    boxes = [Box("bowl", (0, 0, 0.02), (0.4, 0.4, 0.04)), Box("ball", (0, 0, 0.14), (0.2, 0.2, 0.2))]
    field, both = with_whole(planted_room(boxes), [0, 1])
    choose = import_module("scoup.query.thing_judge").choose_things
    coarse = lambda known, fits, level: choose(known, fits, 1 if level is None else level)  # noqa: E731
    monkeypatch.setattr("scoup.query.thing_judge.choose_things", coarse)
    texts, viewed = (
        ["ball on bowl", "bowl on ball", "ball above the bowl", "ball or bowl"],
        ViewedField(field),
    )
    answers = by_page(viewed, texts)
    check_alike(viewed, texts, answers)
    found = [answer["chosen_things"] if answer["present"] else [] for answer in answers]
    assert found == [[1], [], [1], [both]]


@pytest.mark.parametrize("levels", [1, 2])
def test_the_program_of_the_page_answers_as_python_does(levels: int, by_page) -> None:
    viewed = ViewedField(room(levels))
    texts = [*PHRASES, *UNUSUAL, *(REFUSED if levels == 1 else random_phrases(80))]
    answers = by_page(viewed, texts)
    check_alike(viewed, texts, answers)
    said = dict(zip(texts, answers, strict=True))
    assert sum(answer.get("present", False) for answer in answers) > len(PHRASES)
    if levels == 1:
        assert [text for text in REFUSED if "refused" not in said[text]] == []
        found = {
            text: set(said[text]["chosen_things"]) if said[text]["present"] else set() for text in PHRASES
        }
        assert found == PHRASES
        assert said["mug nearest to the pen"]["asked"] == "mug nearest to the pen"
        assert said["salt and pepper on the table"]["asked"] == '"salt and pepper" on the table'
        assert said["Salt and pepper"]["asked"] == '"Salt and pepper"'
        for text in ("mug across the table", "second mug", "mug between laptop"):
            assert said[text]["refused"] == by_python(viewed, text)["refused"]
