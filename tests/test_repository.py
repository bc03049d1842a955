"""What stands around the code: workflows, containers, community files and the tools of a release name what is there."""

from __future__ import annotations

import fnmatch
import json
import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from tools import check_distributions

from scoup.base import VERSION
from scoup.base.errors import FieldVersionError
from scoup.view.viewer import PORT

ROOT = Path(__file__).resolve().parents[1]
PYPROJECT = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
FOLDER = ROOT / ".github" / "workflows"
WORKFLOWS = sorted(path.stem for path in FOLDER.glob("*.yml"))
RECIPES = sorted((ROOT / "docker").glob("Dockerfile*"))
TEXTS = (
    "CONTRIBUTING.md",
    "SECURITY.md",
    "CODE_OF_CONDUCT.md",
    "docs/versions.md",
    ".github/pull_request_template.md",
)
OWN = ("benchmarks", "examples", "scoup", "tools")
"""Packages of this repository that a step may run with python -m."""
every_workflow = pytest.mark.parametrize("name", WORKFLOWS)


def load(name: str) -> dict[str, Any]:
    return yaml.safe_load((FOLDER / f"{name}.yml").read_text(encoding="utf-8"))


def steps(name: str) -> list[dict[str, Any]]:
    return [step for content in load(name)["jobs"].values() for step in content.get("steps", ())]


def commands(name: str) -> Iterator[list[str]]:
    """The words of every command that a workflow runs."""
    for step in steps(name):
        for line in re.split(r"\n|&&|\|\|", step.get("run", "")):
            words = shlex.split(line.partition(" > ")[0], comments=True)
            while words and re.fullmatch(r"\w+=.*", words[0]):
                words = words[1:]
            if words:
                yield words


def is_module(name: str) -> bool:
    places = [folder / Path(*name.split(".")) for folder in (ROOT, ROOT / "src")]
    return any(place.with_suffix(".py").is_file() or (place / "__main__.py").is_file() for place in places)


@every_workflow
def test_what_is_run_is_there(name: str) -> None:
    targets = set(re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    for words in commands(name):
        if words[0] == "make":
            assert words[1] in targets
        elif re.fullmatch(r"(\S+/)?python", words[0]) and words[1] == "-m":
            assert words[2].split(".")[0] not in OWN or is_module(words[2]), words
        elif re.fullmatch(r"(\S+/)?python", words[0]):
            assert (ROOT / words[1]).is_file(), words


@every_workflow
def test_nothing_is_permitted_but_where_it_is_needed(name: str) -> None:
    """Actions are pinned by commit, and what an event says does not become part of a command: variables carry it."""
    assert load(name)["permissions"] == {}
    for job, content in load(name)["jobs"].items():
        if name != "release" and "deploy" not in job:
            assert content["permissions"] == {"contents": "read"}, job
    for step in steps(name):
        assert re.fullmatch(r"[\w-]+/[\w-]+@[0-9a-f]{40}", step.get("uses", f"a/b@{'0' * 40}")), step
        assert "${{" not in step.get("run", "")
        if step.get("uses", "").startswith("actions/checkout@"):
            assert step["with"]["persist-credentials"] is False


def test_versions_of_python_are_tested_and_have_wheels() -> None:
    served = re.findall(r'"Programming Language :: Python :: (3\.\d+)"', PYPROJECT)
    assert load("tests")["jobs"]["test"]["strategy"]["matrix"]["python"] == served
    assert f'requires-python = ">={served[0]}"' in PYPROJECT
    (build,) = re.findall(r"^build = (\[.*?\])", PYPROJECT, re.MULTILINE | re.DOTALL)
    stable = re.findall(r'^wheel.py-api = "cp3(\d+)"$', PYPROJECT, re.MULTILINE)[0]
    built = re.findall(r'"cp3(\d+)-\*"', build)
    assert [f"3.{minor}" for minor in built] == served
    # One wheel for each version before the stable interface, and one for all from there on.
    own = [f"cp3{minor}-cp3{minor}" for minor in built if int(minor) < int(stable)]
    assert list(check_distributions.PYTHONS) == [*own, f"cp3{stable}-abi3"]
    parts = re.findall(r"^archs = (\[.*\])$", PYPROJECT, re.MULTILINE)
    matrix = load("wheels")["jobs"]["wheels"]["strategy"]["matrix"]["include"]
    assert sorted(each["archs"] for each in matrix) == sorted(
        arch for part in parts for arch in json.loads(part)
    )


def test_what_is_published_has_the_hashes_that_were_checked() -> None:
    for name, job in load("release")["jobs"].items():
        of_job = job.get("steps", ())
        taken = [
            place for place, step in enumerate(of_job) if str(step.get("with", {}).get("pattern")) == "dist-*"
        ]
        if taken:
            assert "sha256sum --check --strict" in of_job[taken[0] + 1].get("run", ""), name
        assert taken or not any("publish" in step.get("uses", "") for step in of_job)
    wanted = re.findall(
        r"^([\w-]+)(?:\[\w+\])?(==\S+)?$", (ROOT / ".github/tools.in").read_text(), re.MULTILINE
    )
    locked = (ROOT / ".github/tools.txt").read_text()
    for name, version in wanted:
        pinned = rf"^{name}{re.escape(version) or '=='}\S* \\\n    --hash=sha256:"
        assert re.search(pinned, locked, re.MULTILINE), name
    for words in [*commands("wheels"), *commands("release")]:
        assert "pip" not in words or words[0] == "uv" or "--require-hashes" in words, words


def lines(path: Path) -> list[tuple[str, str]]:
    """Instruction and arguments of each line of a recipe, comments left out and continued lines joined."""
    text = re.sub(r"^#.*\n", "", path.read_text(), flags=re.MULTILINE).replace("\\\n", " ")
    return [(words[0], words[1]) for line in text.splitlines() if len(words := line.split(maxsplit=1)) == 2]


def is_sent(path: str) -> bool:
    """Whether .dockerignore lets a path of the repository through: the last pattern that fits it decides."""
    sent = True
    parents = [path, *(str(parent) for parent in Path(path).parents)]
    for pattern in (ROOT / ".dockerignore").read_text().splitlines():
        bare = pattern.removeprefix("!").removeprefix("**/")
        fits = any(fnmatch.fnmatch(each, bare) or fnmatch.fnmatch(Path(each).name, bare) for each in parents)
        if pattern and fits:
            sent = pattern.startswith("!")
    return sent


@pytest.mark.parametrize("path", RECIPES, ids=lambda path: path.name)
def test_containers_have_what_they_need(path: Path) -> None:
    copies = [
        rest.split()[:-1] for word, rest in lines(path) if word == "COPY" and not rest.startswith("--from")
    ]
    copied = {source for sources in copies for source in sources}
    needed = re.findall(
        r'^(?:readme|cmake\.source-dir) = "(\S+)"|backend-path = \["(\S+)"\]', PYPROJECT, re.MULTILINE
    )
    assert {"pyproject.toml", "src", "viewer", "native", "tools", *map("".join, needed)} <= copied
    for source in copied:
        assert (ROOT / source).exists(), source
        assert is_sent(source), source
    section = PYPROJECT.split("[project.optional-dependencies]")[1].split("\n[")[0]
    (extras,) = [
        rest.removeprefix("EXTRAS=").split(",") for _, rest in lines(path) if rest.startswith("EXTRAS=")
    ]
    assert {"view", "models"} <= set(extras) <= set(re.findall(r"^([\w-]+) = \[", section, re.MULTILINE))
    last = dict(lines(path))
    assert last["USER"] not in ("root", "0", "0:0")
    assert last["EXPOSE"] == str(PORT)


@pytest.mark.parametrize("name", TEXTS)
def test_paths_in_texts_exist(name: str) -> None:
    """Those in backticks, but for names of users' files; test_site.py follows links."""
    found = re.findall(r"`(\.?[\w-]+(?:/[\w.-]+)+/?|[\w-]+\.(?:md|toml|cff))`", (ROOT / name).read_text())
    of_users = re.compile(r"NAME|FOLDER|regions\.json|\.venv/")
    assert [path for path in found if not (ROOT / path).exists() and not of_users.search(path)] == []


def test_the_repository_has_one_address_and_the_citation_this_version() -> None:
    others = [*(ROOT / ".github" / "ISSUE_TEMPLATE").glob("*"), *(ROOT / "notebooks").glob("*.ipynb")]
    places = [ROOT / "CITATION.cff", *(ROOT / name for name in TEXTS), *(ROOT / "docker").glob("*"), *others]
    address = r"https://(?:colab\.research\.google\.com/github|github\.com)/([\w-]+)/scoup"
    assert {owner for path in places for owner in re.findall(address, path.read_text())} == {"scoup"}
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert str(citation["version"]) == VERSION
    assert "not the paper's authors" in citation["authors"][0]["name"]


def test_the_sentence_of_refusal_is_the_real_one() -> None:
    assert f"> {FieldVersionError('FILE', 2, 1)}" in (ROOT / "docs" / "versions.md").read_text()
