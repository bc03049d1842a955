"""The recipes of containers name files, extras and options that exist; nothing is built here."""

from __future__ import annotations

import fnmatch
import re
from dataclasses import fields
from pathlib import Path

import pytest

from scoup.cli.view import View
from scoup.view.viewer import PORT

ROOT = Path(__file__).resolve().parents[1]
RECIPES = sorted((ROOT / "docker").glob("Dockerfile*"))


def lines(path: Path) -> list[tuple[str, str]]:
    """Instruction and arguments of each line, comments left out and continued lines joined."""
    text = re.sub(r"^#.*\n", "", path.read_text(), flags=re.MULTILINE).replace("\\\n", " ")
    return [(words[0], words[1]) for line in text.splitlines() if len(words := line.split(maxsplit=1)) == 2]


def is_sent(path: str) -> bool:
    """Whether .dockerignore lets a path of the repository through: the last pattern that fits it decides."""
    sent = True
    for pattern in (ROOT / ".dockerignore").read_text().splitlines():
        if pattern and not pattern.startswith("#"):
            bare = pattern.removeprefix("!").removeprefix("**/")
            parents = [path, *(str(parent) for parent in Path(path).parents)]
            if any(fnmatch.fnmatch(each, bare) or fnmatch.fnmatch(Path(each).name, bare) for each in parents):
                sent = pattern.startswith("!")
    return sent


@pytest.mark.parametrize("path", RECIPES, ids=lambda path: path.name)
def test_what_is_copied_is_there(path: Path) -> None:
    copied = [
        source
        for word, rest in lines(path)
        if word == "COPY" and not rest.startswith("--from")
        for source in rest.split()[:-1]
    ]
    assert {"pyproject.toml", "src", "viewer", "native", "tools"} <= set(copied)
    for source in copied:
        assert (ROOT / source).exists(), source
        assert is_sent(source), source
    # A wheel is made of all that the build needs.
    project = (ROOT / "pyproject.toml").read_text()
    for needed in re.findall(
        r'^(?:readme|cmake\.source-dir) = "(\S+)"|backend-path = \["(\S+)"\]', project, re.MULTILINE
    ):
        assert "".join(needed) in copied


@pytest.mark.parametrize("path", RECIPES, ids=lambda path: path.name)
def test_extras_exist(path: Path) -> None:
    section = (
        (ROOT / "pyproject.toml").read_text().split("[project.optional-dependencies]")[1].split("\n[")[0]
    )
    known = set(re.findall(r"^([\w-]+) = \[", section, re.MULTILINE))
    (extras,) = [rest.removeprefix("EXTRAS=") for word, rest in lines(path) if rest.startswith("EXTRAS=")]
    assert set(extras.split(",")) <= known
    assert {"view", "models"} <= set(extras.split(","))


@pytest.mark.parametrize("path", RECIPES, ids=lambda path: path.name)
def test_it_runs_scoup_as_nobody_in_particular(path: Path) -> None:
    last = dict(lines(path))
    assert last["ENTRYPOINT"] == '["scoup"]'
    assert last["USER"] not in ("root", "0", "0:0")
    assert last["EXPOSE"] == str(PORT)
    assert last["VOLUME"] == '["/data", "/cache"]'


def test_the_document_names_what_exists() -> None:
    text = (ROOT / "docs" / "docker.md").read_text()
    assert f"127.0.0.1:{PORT}:{PORT}" in text
    assert "--host 0.0.0.0" in text
    assert "host" in {field.name for field in fields(View)}
    for name in re.findall(r"--build-arg (\w+)=", text):
        assert any(
            rest.startswith(f"{name}=") for path in RECIPES for word, rest in lines(path) if word == "ARG"
        )
    for link in re.findall(r"\]\((\w+\.md)", text):
        assert (ROOT / "docs" / link).is_file()
