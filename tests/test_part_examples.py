"""The examples that build in parts, without the engines (tests/test_engines.py has Slurm and Ray), and the script for
many scenes."""

from __future__ import annotations

import os
import re
import shutil
import sys
from pathlib import Path

import pytest

from children import finished
from cli_support import run, write_scene

pytestmark = pytest.mark.usefixtures("quick_python")

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = ROOT / "examples"
(SLURM,) = re.findall(
    r"^```bash\n(.*?)^```$", (ROOT / "docs" / "many_scenes.md").read_text(), re.MULTILINE | re.DOTALL
)
needs_make = pytest.mark.skipif(shutil.which("make") is None, reason="there is no program make")
SCOUP = """#!/bin/sh
exec "$PYTHON" -c "from scoup.cli.app import entry; entry()" "$@"
"""
SRUN = """#!/bin/sh
[ -e killed ] || { touch killed; exit 137; }
exec "$@"
"""
SBATCH = """#!/bin/bash
echo "$*" >> calls
while [ $# -gt 1 ]; do
    case $1 in --parsable) parsable=1 ;; --array=1-*) count=${1#--array=1-} ;; --wrap) wrap=$2 ;; esac
    shift
done
for ((number = 1; number <= ${count:-1}; number++)); do
    SLURM_ARRAY_TASK_ID=$number bash -c "$wrap" >&2 || exit
done
[ -z "${parsable:-}" ] || echo "7;cluster"
"""


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a scene and the field that one process builds of it."""
    folder = tmp_path_factory.mktemp("parts")
    write_scene(folder / "scene", count=600)
    table = folder / "scene" / "words.npz"
    assert run("build", folder / "scene", "--out", folder / "alone.scoup", "--model", table)[0] == 0
    return folder


@pytest.fixture
def parts_folder(original: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
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
    done = finished(command)
    assert done.returncode == code, done.stdout + done.stderr
    return done.stdout + done.stderr


def is_whole(field: str = "g.scoup") -> bool:
    return Path(field).read_bytes() == Path("alone.scoup").read_bytes()


def test_slurm(parts_folder: Path) -> None:
    """With a stand-in that runs jobs at once; the first task is killed once."""
    for name, text in {"sbatch": SBATCH, "srun": SRUN}.items():
        program = parts_folder.parent / "programs" / name
        program.write_text(text)
        program.chmod(0o755)
    submit = ("bash", EXAMPLES / "slurm.sh", "scene", "g.scoup", 3, "--model", "scene/words.npz")
    printed = launched(*submit)
    assert Path("killed").exists()
    assert printed.count("with all parts there") == 3
    assert "--dependency=afterok:7" in Path("calls").read_text()
    assert is_whole()
    assert "contains 4 views already" in launched(*submit)
    assert is_whole()
    assert "pass SCENE FIELD.scoup COUNT" in launched(*submit[:4], code=1)


@needs_make
def test_make(parts_folder: Path) -> None:
    make = ("make", "-f", EXAMPLES / "parts.mk", "SCENE=scene", "FIELD=g.scoup", "COUNT=3")
    options = ("BUILD=--model scene/words.npz --json",)
    assert "pass SCENE=FOLDER" in launched(*make[:-2], code=2)
    launched(*make, *options, "-j", "2")
    assert is_whole()
    made = Path("g.scoup").stat()
    Path("g.scoup.sums/part-2-of-3.done").unlink()
    assert len(re.findall("^scoup build scene", launched(*make, *options), re.MULTILINE)) == 2
    assert is_whole()
    assert Path("g.scoup").stat().st_mtime_ns > made.st_mtime_ns


@pytest.fixture
def scenes(parts_folder: Path) -> None:
    """Two scenes, and a folder for their fields."""
    for name in "ab":
        shutil.copytree("scene", f"scenes/{name}")
    Path("fields").mkdir()


@pytest.mark.skipif(sys.platform == "win32", reason="a script of Unix shells")
def test_slurm_deals_scenes_out(scenes: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each task as Slurm would start it, without a GPU."""
    script = SLURM.replace(" --device cuda", "")
    monkeypatch.setenv("SLURM_ARRAY_TASK_COUNT", "2")
    for task, made in (("1", ["b.scoup"]), ("0", ["a.scoup", "b.scoup"])):
        monkeypatch.setenv("SLURM_ARRAY_TASK_ID", task)
        launched("bash", "-c", script)
        assert sorted(path.name for path in Path("fields").glob("*.scoup")) == made
    for name in "ab":
        assert run("info", f"fields/{name}.scoup")[0] == 0
