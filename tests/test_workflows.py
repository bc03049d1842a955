"""What runs on the machines of GitHub names what is there: make targets, modules, files, versions of Python, wheels."""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from tools import check_distributions

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / ".github" / "workflows"
NAMES = sorted(path.stem for path in FOLDER.glob("*.yml"))
PYPROJECT = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
OWN = ("benchmarks", "examples", "scoup", "tools")
"""Packages of this repository that a step may run with python -m."""


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


def is_there(module: str) -> bool:
    path = Path(*module.split("."))
    places = [folder / path for folder in (ROOT, ROOT / "src")]
    return any(place.with_suffix(".py").is_file() or (place / "__main__.py").is_file() for place in places)


@pytest.mark.parametrize("name", NAMES)
def test_what_is_run_is_there(name: str) -> None:
    targets = set(re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    for words in commands(name):
        if words[0] == "make":
            assert words[1] in targets
        elif re.fullmatch(r"(\S+/)?python", words[0]) and words[1] == "-m":
            assert words[2].split(".")[0] not in OWN or is_there(words[2]), words
        elif re.fullmatch(r"(\S+/)?python", words[0]):
            assert (ROOT / words[1]).is_file(), words


@pytest.mark.parametrize("name", NAMES)
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
    found = re.search(r"^build = (\[.*?\])", PYPROJECT, re.MULTILINE | re.DOTALL)
    stable = re.search(r'^wheel.py-api = "cp3(\d+)"$', PYPROJECT, re.MULTILINE)
    assert found is not None
    assert stable is not None
    built = re.findall(r'"cp3(\d+)-\*"', found[1])
    assert [f"3.{minor}" for minor in built] == served
    # One wheel for each version before the stable interface, and one for all from there on.
    own = [f"cp3{minor}-cp3{minor}" for minor in built if int(minor) < int(stable[1])]
    assert list(check_distributions.PYTHONS) == [*own, f"cp3{stable[1]}-abi3"]
    archs = [
        arch
        for part in re.findall(r"^archs = (\[.*\])$", PYPROJECT, re.MULTILINE)
        for arch in json.loads(part)
    ]
    matrix = load("wheels")["jobs"]["wheels"]["strategy"]["matrix"]["include"]
    assert sorted(each["archs"] for each in matrix) == sorted(archs)


def test_a_release_waits_for_the_check_of_its_tag() -> None:
    jobs = load("release")["jobs"]
    order = ["version", "wheels", "sbom", "attest", "pypi", "github"]
    assert list(jobs) == order
    needs = [jobs[job]["needs"] for job in order[1:]]
    assert [need if isinstance(need, str) else need[0] for need in needs] == order[:-1]


def test_what_is_published_has_the_hashes_that_were_checked() -> None:
    for name, job in load("release")["jobs"].items():
        uses = [step.get("uses", "").split("@")[0] for step in job.get("steps", ())]
        runs = [step.get("run", "") for step in job.get("steps", ())]
        taken = [
            step for step in job.get("steps", ()) if str(step.get("with", {}).get("pattern")) == "dist-*"
        ]
        if taken:
            place = job["steps"].index(taken[0])
            assert "sha256sum --check --strict" in runs[place + 1], name
        assert not any("publish" in use for use in uses) or taken


def test_tools_of_a_release_are_locked_by_hash() -> None:
    wanted = re.findall(
        r"^([\w-]+)(?:\[\w+\])?(==\S+)?$", (ROOT / ".github/tools.in").read_text(), re.MULTILINE
    )
    locked = (ROOT / ".github/tools.txt").read_text()
    assert len(wanted) == 7
    for name, version in wanted:
        assert re.search(
            rf"^{name}{re.escape(version) or '=='}\S* \\\n    --hash=sha256:", locked, re.MULTILINE
        ), name
    for name in ("wheels", "release"):
        for words in commands(name):
            assert "pip" not in words or words[0] == "uv" or "--require-hashes" in words, words
