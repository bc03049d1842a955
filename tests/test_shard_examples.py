"""The examples that build in shards, without the engines (tests/test_engines.py has Slurm and Ray)."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from cli_support import run, write_scene

pytestmark = pytest.mark.usefixtures("quick_python")

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
SCOUP = """#!/bin/sh
exec "$PYTHON" -c "from scoup.cli.app import entry; entry()" "$@"
"""
TOLD = """#!/bin/sh
trap 'touch told; exit 143' TERM
touch begun
while :; do sleep 0.05; done
"""


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a scene and the field that one process builds of it."""
    folder = tmp_path_factory.mktemp("shards")
    write_scene(folder / "scene", count=600)
    table = folder / "scene" / "words.npz"
    assert run("build", folder / "scene", "--out", folder / "alone.scoup", "--model", table)[0] == 0
    return folder


@pytest.fixture
def here(original: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The current folder, a copy of ``original``; scoup is on the PATH."""
    folder = Path(shutil.copytree(original, tmp_path / "here"))
    monkeypatch.chdir(folder)
    programs = tmp_path / "programs"
    programs.mkdir()
    (programs / "scoup").write_text(SCOUP)
    (programs / "scoup").chmod(0o755)
    monkeypatch.setenv("PYTHON", sys.executable)
    monkeypatch.setenv("PATH", f"{programs}{os.pathsep}{os.environ['PATH']}")
    return folder


def launched(*command: object, code: int = 0) -> str:
    """What a program says, on both streams."""
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True)
    assert done.returncode == code, done.stdout + done.stderr
    return done.stdout + done.stderr


def is_whole(field: str = "g.scoup") -> bool:
    return Path(field).read_bytes() == Path("alone.scoup").read_bytes()


def test_slurm_task_whose_shard_is_there(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Submitted again, an array makes what is missing."""
    monkeypatch.setenv("SLURM_CPUS_PER_TASK", "1")
    for number in "12":
        monkeypatch.setenv("SLURM_ARRAY_TASK_ID", number)
        task = ("bash", EXAMPLES / "slurm/shard.sbatch", "scene", "g.scoup", 2, "--model", "scene/words.npz")
        assert "is there already" not in launched(*task)
        assert "is there already" in launched(*task)
    assert "2 shards merged" in launched("bash", EXAMPLES / "slurm/merge.sbatch", "g.scoup", 2)
    assert is_whole()
    assert "give SCENE FIELD.scoup COUNT" in launched("bash", EXAMPLES / "slurm/submit.sh", "scene", code=1)


def test_slurm_signals_reach_scoup(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scoup = here.parent / "programs" / "scoup"
    scoup.write_text(TOLD)
    monkeypatch.setenv("SLURM_ARRAY_TASK_ID", "1")
    script = subprocess.Popen(["bash", str(EXAMPLES / "slurm/shard.sbatch"), "scene", "g.scoup", "2"])
    while not Path("begun").exists():
        time.sleep(0.02)
    script.terminate()
    assert script.wait(60) == 143
    assert Path("told").exists()


def test_slurm_merge_of_shards_that_are_not_all_there(here: Path) -> None:
    """Each is named: one that is missing is an error, not a warning."""
    said = launched("bash", EXAMPLES / "slurm/merge.sbatch", "h.scoup", 2, code=2)
    assert "h.scoup.1-of-2.sums: there is no such folder" in said


@pytest.mark.skipif(shutil.which("make") is None, reason="there is no program make")
def test_make(here: Path) -> None:
    make = ("make", "-f", EXAMPLES / "shards.mk", "SCENE=scene", "FIELD=g.scoup", "COUNT=3")
    options = ("BUILD=--model scene/words.npz", "MERGE=--json")
    assert "give SCENE=FOLDER" in launched(*make[:-2], code=2)
    launched(*make, *options, "-j", "2")
    assert is_whole()
    made = Path("g.scoup").stat()
    shutil.rmtree("g.scoup.2-of-3.sums")
    assert launched(*make, *options).count("scoup build") == 1
    assert is_whole()
    assert Path("g.scoup").stat().st_mtime_ns > made.st_mtime_ns
