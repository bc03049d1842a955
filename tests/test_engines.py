"""Work shared out among machines: with Ray (two nodes of this machine), with make, and by Slurm's recipes, which a
stand-in for Slurm runs at once.

`make test-engines` runs what needs Ray, where it is installed.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from children import child, finished
from cli_support import run, write_scene

pytestmark = pytest.mark.usefixtures("quick_python")
needs_ray = [pytest.mark.slow, pytest.mark.timeout(1800)]

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = ROOT / "examples"
PATIENCE = 900  # seconds: machines that test may be busy
PROGRAMS = {
    # As the kernel does when memory runs out: it kills scoup once, not the script that has started it.
    "scoup": """#!/bin/sh
case "$KILLED $*" in yes*"--part 2/3"*) [ -e killed ] || { echo > killed; kill -9 $$; } ;; esac
exec "$PYTHON" -c "from scoup.cli.app import entry; entry()" "$@"
""",
    "srun": """#!/bin/sh
[ -e killed ] || { touch killed; exit 137; }
exec "$@"
""",
    "sbatch": """#!/bin/bash
echo "$*" >> calls
while [ $# -gt 1 ]; do
    case $1 in --parsable) parsable=1 ;; --array=1-*) count=${1#--array=1-} ;; --wrap) wrap=$2 ;; esac
    shift
done
for ((number = 1; number <= ${count:-1}; number++)); do
    SLURM_ARRAY_TASK_ID=$number bash -c "$wrap" >&2 || exit
done
[ -z "${parsable:-}" ] || echo "7;cluster"
""",
}


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a scene and the field that one process builds of it."""
    folder = tmp_path_factory.mktemp("parts")
    write_scene(folder / "scene", count=600)
    table = folder / "scene" / "words.npz"
    assert run("build", folder / "scene", "--out", folder / "alone.scoup", "--model", table)[0] == 0
    return folder


@pytest.fixture(autouse=True)
def here(original: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The current folder, a copy of ``original``; the programs are on the PATH."""
    folder = Path(shutil.copytree(original, tmp_path / "here"))
    monkeypatch.chdir(folder)
    for name, text in PROGRAMS.items():
        program = tmp_path / "programs" / name
        program.parent.mkdir(exist_ok=True)
        program.write_text(text)
        program.chmod(0o755)
    monkeypatch.setenv("PYTHON", sys.executable)
    monkeypatch.setenv("PATH", f"{tmp_path / 'programs'}{os.pathsep}{os.environ['PATH']}")
    return folder


def launched(*command: object, code: int = 0) -> str:
    """What a program says, on both streams."""
    done = finished(command)
    assert done.returncode == code, done.stdout + done.stderr
    return done.stdout + done.stderr


def is_whole() -> bool:
    return Path("g.scoup").read_bytes() == Path("alone.scoup").read_bytes()


def test_slurm_builds_in_parts_of_which_one_is_killed() -> None:
    submit = ("bash", EXAMPLES / "slurm.sh", "scene", "g.scoup", 3, "--model", "scene/words.npz")
    printed = launched(*submit)
    assert Path("killed").exists()
    assert printed.count("with all parts there") == 3
    assert "--dependency=afterok:7" in Path("calls").read_text()
    assert is_whole()
    assert "contains 4 views already" in launched(*submit)
    assert "pass SCENE FIELD.scoup COUNT" in launched(*submit[:4], code=1)


@pytest.mark.skipif(shutil.which("make") is None, reason="there is no program make")
def test_make_builds_in_parts() -> None:
    make = ("make", "-f", EXAMPLES / "parts.mk", "SCENE=scene", "FIELD=g.scoup", "COUNT=3")
    options = ("BUILD=--model scene/words.npz --json",)
    assert "pass SCENE=FOLDER" in launched(*make[:-2], code=2)
    launched(*make, *options, "-j", "2")
    assert is_whole()
    Path("g.scoup.sums/part-2-of-3.done").unlink()
    assert len(re.findall("^scoup build scene", launched(*make, *options), re.MULTILINE)) == 2


@pytest.mark.skipif(sys.platform == "win32", reason="a script of Unix shells")
def test_slurm_deals_scenes_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """The recipe of the documents: each task as Slurm would start it, without a GPU."""
    (recipe,) = re.findall(
        r"^```bash\n(.*?)^```$", (ROOT / "docs" / "many_scenes.md").read_text(), re.M | re.S
    )
    for name in "ab":
        shutil.copytree("scene", f"scenes/{name}")
    Path("fields").mkdir()
    monkeypatch.setenv("SLURM_ARRAY_TASK_COUNT", "2")
    for task, made in (("1", ["b.scoup"]), ("0", ["a.scoup", "b.scoup"])):
        monkeypatch.setenv("SLURM_ARRAY_TASK_ID", task)
        launched("bash", "-c", recipe.replace(" --device cuda", ""))
        assert sorted(path.name for path in Path("fields").glob("*.scoup")) == made


@pytest.fixture
def ray(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """The address of a cluster of two nodes."""
    pytest.importorskip("ray", reason="ray is not installed")
    from ray.cluster_utils import Cluster  # pyright: ignore[reportMissingImports]

    monkeypatch.setenv("RAY_worker_niceness", "0")  # or busy machines hardly run them
    monkeypatch.setenv("RAY_USAGE_STATS_ENABLED", "0")
    monkeypatch.setenv("KILLED", "yes")
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
    try:
        cluster.add_node(num_cpus=1)
        yield str(cluster.address)
    finally:
        cluster.shutdown()


class TestRay:
    pytestmark = needs_ray

    def test_a_task_that_is_killed(self, here: Path, ray: str, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setenv("RAY_ADDRESS", ray)
        example = (EXAMPLES / "10_parts_with_ray.py", "scene", "scene/words.npz", 3, "g.scoup")
        finished([sys.executable, *example], check=True)
        assert (here / "killed").exists()
        assert is_whole()

    def test_a_batch_of_which_a_worker_is_killed(self, here: Path, ray: str) -> None:
        for name in "abc":
            shutil.copytree("scene", f"scans/{name}")
        batch = ("batch", "scans", "--model", "scene/words.npz", "--json", "--out")
        end = time.monotonic() + PATIENCE
        with child([sys.executable, "-m", "scoup", *batch, "fields", "--ray", ray]) as process:
            while not kill_a_worker(here):
                assert process.poll() is None
                assert time.monotonic() < end
                time.sleep(1)
            out, err = process.communicate()
        assert process.returncode == 0, out + err
        assert json.loads(out)["failed"] == []
        assert run(*batch, "alone")[0] == 0
        for name in "abc":
            assert Path(f"fields/{name}.scoup").read_bytes() == Path(f"alone/{name}.scoup").read_bytes()


def kill_a_worker(folder: Path) -> bool:
    """Kill a worker of Ray that runs a task in a folder, if there is one."""
    for process in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            is_in = (process / "cwd").readlink() == folder
            if is_in and b"ray::_run_here" in (process / "cmdline").read_bytes():
                os.kill(int(process.name), signal.SIGKILL)
                return True
    return False
