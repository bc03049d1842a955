"""The examples that build in shards, with stand-ins for Slurm and Ray: the field of one process, byte for byte."""

from __future__ import annotations

import os
import shutil
import socket
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
TORCHRUN = """#!/bin/sh
exec "$PYTHON" -m torch.distributed.run "$@"
"""
SBATCH = """#!/bin/bash
# Runs a job at once, as the array that --array says, but for the task that FAILS names; a merge behind an array that
# has failed is not run.
for option; do
    case $option in
    --parsable) ;;
    --array=1-*) last=${option#--array=1-} ;;
    --dependency=afterok:7) [ ! -e failed ] || exit 0 ;;
    --kill-on-invalid-dep=yes) ;;
    -*) echo "no option of sbatch: $option" >&2; exit 1 ;;
    *) break ;;
    esac
    shift
done
export SLURM_CPUS_PER_TASK=1
rm -f failed
if [ -n "$last" ]; then
    for ((number = last; number >= 1; number--)); do # in any order
        [ "$number" != "$FAILS" ] || { touch failed; continue; }
        SLURM_ARRAY_TASK_ID=$number bash "$@" >&2 || touch failed
    done
    echo "7;cluster"
else
    exec bash "$@"
fi
"""
SRUN = """#!/bin/bash
# Two nodes, both of them this machine.
[ "$1 $2" = "--cpus-per-task 1" ] || exit 1
shift 2
"$@" & first=$!
"$@" & second=$!
wait $first && wait $second
"""
SCONTROL = """#!/bin/sh
[ "$*" = "show hostnames node[1-2]" ] && printf 'localhost\\nnode2\\n'
"""
RAY = """
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

pool = None

def init():
    global pool
    pool = ThreadPoolExecutor(2)

def remote(work):
    task = SimpleNamespace(remote=lambda *given: pool.submit(work, *given))
    return SimpleNamespace(options=lambda num_cpus, max_retries, retry_exceptions: task)

def get(futures):
    return [future.result() for future in futures]
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
    """The current folder, a copy of ``original``; the programs are on the PATH."""
    folder = Path(shutil.copytree(original, tmp_path / "here"))
    monkeypatch.chdir(folder)
    programs = tmp_path / "programs"
    programs.mkdir()
    for name, text in {
        "scoup": SCOUP, "torchrun": TORCHRUN, "sbatch": SBATCH, "srun": SRUN, "scontrol": SCONTROL
    }.items():  # fmt: skip
        (programs / name).write_text(text)
        (programs / name).chmod(0o755)
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


def test_slurm_array(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A task that fails withdraws the merge; submitted again, it makes the one that is missing."""
    submit = ("bash", EXAMPLES / "slurm/submit.sh", "scene", "g.scoup", 3, "--model", "scene/words.npz")
    with monkeypatch.context() as patch:
        patch.setenv("FAILS", "2")
        said = launched(*submit)
    assert "merged" not in said
    assert sorted(path.name for path in here.glob("g.*")) == ["g.scoup.1-of-3.sums", "g.scoup.3-of-3.sums"]
    said = launched(*submit)
    assert said.count("is there already") == 2
    assert "3 shards merged" in said
    assert is_whole()
    assert "give SCENE FIELD.scoup COUNT" in launched(*submit[:3], code=1)


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


def free_port() -> int:
    """One of those that the script takes."""
    for number in range(10000):
        port = 20000 + (os.getpid() + number) % 10000
        with socket.socket() as tried:
            try:
                tried.bind(("", port))
            except OSError:
                continue
        return port
    pytest.fail("no port from 20000 to 29999 is free")


def test_slurm_with_torchrun(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two nodes with two processes each; there are fewer levels than processes."""
    monkeypatch.setenv("SLURM_JOB_ID", str(free_port() - 20000))
    monkeypatch.setenv("SLURM_JOB_NODELIST", "node[1-2]")
    monkeypatch.setenv("SLURM_NNODES", "2")
    monkeypatch.setenv("PER_NODE", "2")
    launched("bash", EXAMPLES / "slurm/torchrun.sbatch", "scene", "g.scoup", "--model", "scene/words.npz")
    assert is_whole()
    assert not list(here.glob("g.scoup.*"))


def test_ray(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (here / "ray.py").write_text(RAY)
    paths = [str(here), os.environ.get("PYTHONPATH", "")]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(path for path in paths if path))
    example = (sys.executable, EXAMPLES / "11_shards_with_ray.py", "scene", "scene/words.npz", 3, "g.scoup")
    launched("scoup", "build", "scene", "--out", "g.scoup", "--shard", "3/3", "--model", "scene/words.npz")
    said = launched(*example)
    assert said.count("when all shards are there") == 2
    assert "3 shards merged" in said
    assert is_whole()


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
