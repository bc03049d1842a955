"""What runs on the machines of GitHub names what is there: make targets, modules, files, versions of Python, wheels."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from tools import check_distributions

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / ".github" / "workflows"
NAMES = ("docs", "gpu", "release", "tests", "weekly", "wheels")
PYPROJECT = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
ACTION = re.compile(r"[\w-]+/[\w-]+@v\d+\.\d+\.\d+")
OWN = ("benchmarks", "examples", "scoup", "tools")
"""Packages of this repository that a step may run with python -m."""


def load(name: str) -> dict[str, Any]:
    """A workflow; YAML takes its key "on" for a truth value."""
    content = yaml.safe_load((FOLDER / f"{name}.yml").read_text(encoding="utf-8"))
    return {"on" if key is True else key: value for key, value in content.items()}


def steps(name: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """The job and the step, for all steps of a workflow."""
    for job, content in load(name)["jobs"].items():
        yield from ((job, step) for step in content.get("steps", ()))


def commands(name: str) -> Iterator[list[str]]:
    """The words of every command that a workflow runs."""
    for _, step in steps(name):
        for line in re.split(r"\n|&&|\|\|", step.get("run", "")):
            words = shlex.split(line.partition(" > ")[0], comments=True)
            while words and re.fullmatch(r"\w+=.*", words[0]):
                words = words[1:]
            if words:
                yield words


def is_there(module: str) -> bool:
    """Whether a module of this repository can be run."""
    path = Path(*module.split("."))
    folders = (ROOT, ROOT / "src")
    return any(
        (folder / path).with_suffix(".py").is_file() or (folder / path / "__main__.py").is_file()
        for folder in folders
    )


def listed(key: str) -> list[str]:
    """The strings of a list in pyproject.toml."""
    found = re.search(rf"^{re.escape(key)} = (\[.*?\])", PYPROJECT, re.MULTILINE | re.DOTALL)
    assert found is not None, key
    return json.loads(re.sub(r",\s*\]", "]", re.sub(r"#.*", "", found[1])))


def served() -> list[str]:
    """The versions of Python that the package says it serves, as "3.10"."""
    return re.findall(r'"Programming Language :: Python :: (3\.\d+)"', PYPROJECT)


def test_all_are_looked_at() -> None:
    assert {path.name for path in FOLDER.iterdir()} == {f"{name}.yml" for name in NAMES}


@pytest.mark.parametrize("name", NAMES)
def test_nothing_is_permitted_but_where_it_is_needed(name: str) -> None:
    workflow = load(name)
    assert workflow["permissions"] == {}
    assert "concurrency" in workflow
    for job, content in workflow["jobs"].items():
        allowed = content["permissions"]
        assert set(allowed.values()) <= {"read", "write"}, job
        if name != "release" and "deploy" not in job:
            assert allowed == {"contents": "read"}, job
        assert "uses" in content or content["timeout-minutes"] <= 180, job


@pytest.mark.parametrize("name", NAMES)
def test_actions_are_named_by_full_versions(name: str) -> None:
    used = [step["uses"] for _, step in steps(name) if "uses" in step]
    assert used
    assert [each for each in used if ACTION.fullmatch(each) is None] == []
    kept = [step for _, step in steps(name) if step.get("uses", "").startswith("actions/checkout@")]
    assert all(step["with"]["persist-credentials"] is False for step in kept)


@pytest.mark.parametrize("name", NAMES)
def test_no_outer_text_in_commands(name: str) -> None:
    """What an event says must not become part of a command; variables carry it."""
    assert [step["run"] for _, step in steps(name) if "${{" in step.get("run", "")] == []


@pytest.mark.parametrize("name", NAMES)
def test_make_targets_are_there(name: str) -> None:
    targets = set(re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    wanted = {words[1] for words in commands(name) if words[0] == "make"}
    assert wanted - targets == set()


@pytest.mark.parametrize("name", NAMES)
def test_modules_and_files_are_there(name: str) -> None:
    for words in commands(name):
        if re.fullmatch(r"(\S+/)?python", words[0]) is None:
            continue
        if words[1] == "-m":
            assert words[2].split(".")[0] not in OWN or is_there(words[2]), words
        else:
            assert (ROOT / words[1]).is_file(), words


@pytest.mark.parametrize("name", NAMES)
def test_options_of_our_programs_are_known(name: str) -> None:
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "src")}
    programs: dict[tuple[str, ...], set[str]] = {}
    for words in commands(name):
        is_module = words[1:2] == ["-m"] and words[2].startswith("benchmarks")
        if words[0] == "python" and (is_module or words[1].startswith("tools/")):
            options = {word for word in words if re.fullmatch(r"--[a-z-]+", word)}
            end = 4 if words[2:3] == ["benchmarks"] else 3  # of which the study is a part
            programs.setdefault(tuple(words[1:end] if is_module else words[1:2]), set()).update(options)
    for program, options in programs.items():
        said = subprocess.run(
            [sys.executable, *program, "--help"], cwd=ROOT, env=environment, capture_output=True, text=True
        ).stdout
        assert "usage:" in said, program
        assert {option for option in options if option not in said} == set(), program


def test_versions_of_python_are_tested_and_stated() -> None:
    matrix = load("tests")["jobs"]["test"]["strategy"]["matrix"]
    assert matrix["python"] == served()
    assert f'requires-python = ">={served()[0]}"' in PYPROJECT
    ends = {served()[0], served()[-1]}
    for system in ("macos", "windows"):
        assert {each["python"] for each in matrix["include"] if each["os"].startswith(system)} == ends


def test_wheels_are_made_for_the_versions_and_systems_stated() -> None:
    built = [f"3.{selector.removeprefix('cp3').removesuffix('-*')}" for selector in listed("build")]
    assert built == served()
    stable = re.search(r'^wheel.py-api = "(cp\d+)"$', PYPROJECT, re.MULTILINE)
    assert stable is not None
    # One wheel for each version before the stable interface, and one for all from there on.
    own = [
        selector.removesuffix("-*") for selector in listed("build") if int(selector[3:5]) < int(stable[1][3:])
    ]
    tags = [*(f"{version}-{version}" for version in own), f"{stable[1]}-abi3"]
    assert tags == list(check_distributions.PYTHONS)
    archs = [
        arch
        for part in re.findall(r"^archs = (\[.*\])$", PYPROJECT, re.MULTILINE)
        for arch in json.loads(part)
    ]
    matrix = load("wheels")["jobs"]["wheels"]["strategy"]["matrix"]["include"]
    assert sorted(each["archs"] for each in matrix) == sorted(archs)
    assert len(check_distributions.PLATFORMS) == len(archs)


def test_a_release_waits_for_the_check_of_its_tag() -> None:
    jobs = load("release")["jobs"]
    order = ["version", "wheels", "sbom", "attest", "pypi", "github"]
    assert list(jobs) == order
    assert [jobs[job]["needs"] for job in order[1:]] == order[:-1]
    assert jobs["wheels"]["uses"] == "./.github/workflows/wheels.yml"
    writes = {
        job: {key for key, value in jobs[job]["permissions"].items() if value == "write"} for job in order
    }
    assert writes["pypi"] == {"id-token"}
    assert writes["github"] == {"contents"}


def test_the_gpu_workflow_runs_what_the_document_says() -> None:
    document = (ROOT / "docs" / "gpu.md").read_text(encoding="utf-8")
    stated = {
        line.partition(" --out")[0]
        for line in document.splitlines()
        if line.startswith("python -m benchmarks.gpu")
    }
    run = [" ".join(words).partition(" --out")[0] for words in commands("gpu") if "benchmarks.gpu" in words]
    assert len(run) == 4
    assert set(run) <= stated


def test_dependabot_looks_after_all_kinds() -> None:
    content = yaml.safe_load((ROOT / ".github" / "dependabot.yml").read_text(encoding="utf-8"))
    assert {each["package-ecosystem"] for each in content["updates"]} == {"github-actions", "pip", "npm"}
    assert all((ROOT / each["directory"].strip("/")).is_dir() for each in content["updates"])


@pytest.mark.parametrize(
    "command",
    [
        ["zizmor", "--offline", ".github"],
        [
            "check-jsonschema",
            "--builtin-schema",
            "vendor.github-workflows",
            *(f".github/workflows/{name}.yml" for name in NAMES),
        ],
        ["check-jsonschema", "--builtin-schema", "vendor.dependabot", ".github/dependabot.yml"],
        ["actionlint"],
    ],
    ids=["zizmor", "schema", "schema of dependabot", "actionlint"],
)
def test_linters_find_nothing(command: list[str]) -> None:
    if shutil.which(command[0]) is None:
        pytest.skip(f"{command[0]} is not installed")
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
