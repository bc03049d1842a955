"""README and the first pages, as a new user reads them: commands run or are parsed, Python prints what they say."""

from __future__ import annotations

import doctest
import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest
from benchmarks.documents import ROOT

import scoup
from cli_support import run_json
from scoup.cli.app import SCOUP
from scoup.cli.parsing import parse
from scoup_lab.synthetic import make_demo_scene, write_demo_scene

README = ROOT / "README.md"
FIRST = (
    README,
    *(ROOT / "docs" / f"{name}.md" for name in ("index", "getting_started", "own_scene", "query")),
)


def commands(page: Path) -> Iterator[list[str]]:
    """The words behind `scoup` of every command in the blocks of a page."""
    for block in re.findall(r"^```\n(.*?)^```$", page.read_text(), re.MULTILINE | re.DOTALL):
        for line in re.findall(r"^scoup (.*)$", block, re.MULTILINE):
            yield shlex.split(line, comments=True)


@pytest.mark.parametrize("page", FIRST, ids=lambda page: page.stem)
def test_commands_are_parsed_and_pictures_are_there(page: Path) -> None:
    for words in commands(page):
        parse(words, SCOUP, "scoup")
    pictures = re.findall(r'!\[[^\]]*\]\(([^)]+)\)|src(?:set)?="([^"]+)"', page.read_text())
    for markdown, html in pictures:
        picture = markdown or html
        assert picture.startswith("https://") or (page.parent / picture).is_file(), picture


def test_commands_of_the_readme_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a small scene of the demo; the viewer is started by the tests of servers."""
    monkeypatch.chdir(tmp_path)
    write_demo_scene(make_demo_scene(0, 3000, 96, 72, 4, 1), "scene")
    places = {"SCENE": "scene", "point_cloud.ply": "scene/point_cloud.ply"}
    for words in commands(README):
        if words[0] != "view":
            of_demo = ("--model", "scene/text.npz") * (words[0] == "build")  # its embeddings are simulated
            run_json(*(places.get(word, word) for word in words), *of_demo)
    assert {"scene.scoup", "blue.ply"} <= {path.name for path in tmp_path.iterdir()}


@pytest.mark.slow
def test_python_of_the_readme_prints_what_it_says(monkeypatch: pytest.MonkeyPatch) -> None:
    """On the field of `make demo`, which CI makes before."""
    if not (ROOT / "demo" / "demo.scoup").is_file():
        pytest.skip("there is no demo/demo.scoup; run make demo")
    monkeypatch.chdir(ROOT)
    (block,) = re.findall(r"```python\n(.*?)```", README.read_text(), re.DOTALL)
    example = doctest.DocTestParser().get_doctest(block, {"scoup": scoup}, "README", str(README), 0)
    said: list[str] = []
    result = doctest.DocTestRunner().run(example, out=said.append)
    assert result.failed == 0, "".join(said)
    assert result.attempted >= 5
