"""The recipes of docs/many_scenes.md, run with the tools that are installed."""

from __future__ import annotations

import os
import re
import shutil
import sys
from pathlib import Path

import pytest

from children import finished
from cli_support import RUN, run, write_scene

pytestmark = pytest.mark.usefixtures("quick_python")
PAGE = Path(__file__).resolve().parents[2] / "docs" / "many_scenes.md"
TOOLS = PAGE.read_text().partition("## Other tools")[2]
RECIPES = dict(re.findall(r"^## ([^\n]+)\n(?:(?!^## ).)*?^```\w+\n(.*?)^```$", TOOLS, re.M | re.S))


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Two scenes, a folder for fields, and a program named scoup."""
    for number, name in enumerate("ab"):
        write_scene(tmp_path / "scenes" / name, seed=number)
    (tmp_path / "fields").mkdir()
    (tmp_path / "bin").mkdir()
    program = tmp_path / "bin" / "scoup"
    program.write_text(f"#!/bin/sh\nexec '{sys.executable}' -c '{RUN}' \"$@\"\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", os.pathsep.join([str(program.parent), os.environ["PATH"]]))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(path for path in sys.path if path))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def check_fields() -> None:
    for name in "ab":
        assert run("info", f"fields/{name}.scoup")[0] == 0


def succeeds(*command: object, **more: str) -> None:
    finished(command, check=True, env={**os.environ, **more})


def needs(tool: str) -> None:
    if shutil.which(tool) is None:
        pytest.skip(f"{tool} is not installed")


def test_the_page_has_what_is_tested() -> None:
    assert list(RECIPES) == ["Make", "Slurm"]


@pytest.mark.skipif(sys.platform == "win32", reason="a script of Unix shells")
def test_slurm_deals_scenes_out(here: Path) -> None:
    """Each task as Slurm would start it, without a GPU."""
    script = RECIPES["Slurm"].replace(" --device cuda", "")
    succeeds("bash", "-c", script, SLURM_ARRAY_TASK_ID="1", SLURM_ARRAY_TASK_COUNT="2")
    assert [path.name for path in Path("fields").glob("*.scoup")] == ["b.scoup"]
    succeeds("bash", "-c", script, SLURM_ARRAY_TASK_ID="0", SLURM_ARRAY_TASK_COUNT="2")
    check_fields()


def test_make(here: Path) -> None:
    needs("make")
    Path("Makefile").write_text(RECIPES["Make"])
    succeeds("make", "--keep-going", "--jobs", "2")
    check_fields()
