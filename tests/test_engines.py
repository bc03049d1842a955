"""The examples that build in parts under Slurm (one node on loopback) and Ray (two nodes of this machine) as they are,
and `scoup batch` on Ray.

`make test-all` runs these where the engines are installed (Debian: slurm-wlm and munge; pip: ray);
tests/test_part_examples.py runs what needs no engine.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import socket
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import pytest

from children import child, finished
from cli_support import run
from test_part_examples import EXAMPLES, is_whole
from test_part_examples import original as original
from test_part_examples import parts_folder as parts_folder

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1800), pytest.mark.usefixtures("quick_python")]

PATIENCE = 900  # seconds: machines that test may be busy
# As the kernel does when memory runs out: it kills scoup, not the script that has started it.
SCOUP = """#!/bin/sh
case "$*" in *"--part 2/3"*) [ -e killed ] || { echo > killed; kill -9 $$; } ;; esac
exec "$PYTHON" -c "from scoup.cli.app import entry; entry()" "$@"
"""
SLURM = """
ClusterName=test
SlurmctldHost={host}(127.0.0.1)
SlurmUser={user}
SlurmdUser={user}
AuthInfo=socket={folder}/munge.socket
SlurmctldPort={controller}
SlurmdPort={node}
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
SchedulerParameters=batch_sched_delay=1,sched_interval=2,bf_interval=2
SlurmdParameters=config_overrides
NodeName={host} NodeAddr=127.0.0.1 CPUs=32 RealMemory=64000
PartitionName=all Nodes={host} Default=YES
"""


@pytest.fixture
def here(parts_folder: Path) -> Path:
    """The folder of the other examples, with a program that is killed once."""
    (parts_folder.parent / "programs" / "scoup").write_text(SCOUP)
    return parts_folder


def free_ports() -> tuple[int, int]:
    with socket.create_server(("127.0.0.1", 0)) as one, socket.create_server(("127.0.0.1", 0)) as other:
        return one.getsockname()[1], other.getsockname()[1]


def said(*command: object) -> str:
    """What a program of Slurm prints; "" where it fails, as while the controller starts."""
    done = finished(command)
    return done.stdout.strip() if not done.returncode else ""


def wait_for(what: str, is_there: Any) -> None:
    end = time.monotonic() + PATIENCE
    while not is_there():
        assert time.monotonic() < end, f"{what}, not after {PATIENCE} seconds"
        time.sleep(1)


@pytest.fixture
def slurm(
    here: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> Iterator[None]:
    """A controller and one node, with all of their files in a folder of their own."""
    programs = [
        shutil.which(name, path=f"{os.environ['PATH']}:/usr/sbin")
        for name in ("munged", "slurmctld", "slurmd")
    ]
    if None in programs:
        pytest.skip("Slurm is not installed (slurm-wlm and munge)")
    if os.getuid():
        pytest.skip("a node of Slurm needs root")
    folder = tmp_path_factory.mktemp("slurm")
    controller, node = free_ports()
    host = socket.gethostname().split(".")[0]
    text = SLURM.format(host=host, user="root", folder=folder, controller=controller, node=node)
    (folder / "slurm.conf").write_text(text)
    for name in ("state", "spool"):
        (folder / name).mkdir()
    (folder / "key").write_bytes(os.urandom(128))
    (folder / "key").chmod(0o400)
    monkeypatch.setenv("SLURM_CONF", str(folder / "slurm.conf"))
    places = {
        "key-file": "key",
        "socket": "munge.socket",
        "pid-file": "pid",
        "log-file": "log",
        "seed-file": "seed",
    }
    options = [f"--{option}={folder / name}" for option, name in places.items()]
    with ExitStack() as started:
        for program, given in zip(
            programs, (["--foreground", "--force", *options], ["-D"], ["-D"]), strict=True
        ):
            log = started.enter_context((folder / f"{Path(str(program)).name}.out").open("wb"))
            started.enter_context(child([program, *given], stdout=log, stderr=log))
            if program == programs[0]:
                wait_for("munged has its socket", (folder / "munge.socket").exists)
        wait_for("the node is idle", lambda: "idle" in said("sinfo", "--noheader", "--format=%T"))
        yield


def submitted(*command: object) -> None:
    """Submit jobs and wait for their end; a job that was put back is started at once, not two minutes later."""
    finished(command, check=True)

    def is_done() -> bool:
        waiting = said("squeue", "--noheader", "--array", "--format=%i %r").splitlines()
        for job, reason in (line.split(maxsplit=1) for line in waiting):
            if reason == "BeginTime":
                said("scontrol", "update", f"JobId={job}", "StartTime=now")
        return not waiting

    wait_for("all jobs are done", is_done)


@pytest.mark.usefixtures("slurm")
def test_slurm_array_with_a_task_that_is_killed() -> None:
    submitted("bash", EXAMPLES / "slurm.sh", "scene", "g.scoup", 3, "--model", "scene/words.npz")
    logs = "".join(path.read_text() for path in sorted(Path().glob("scoup-part-*.log")))
    assert Path("killed").exists()
    assert logs.count("with all parts there") == 3
    assert is_whole(), "".join(path.read_text() for path in Path().glob("scoup-build-*.log"))


@pytest.fixture
def ray(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """The address of a cluster of two nodes."""
    pytest.importorskip("ray", reason="ray is not installed")
    from ray.cluster_utils import Cluster  # pyright: ignore[reportMissingImports]

    monkeypatch.setenv("RAY_worker_niceness", "0")  # or busy machines hardly run them
    monkeypatch.setenv("RAY_USAGE_STATS_ENABLED", "0")
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
    try:
        cluster.add_node(num_cpus=1)
        yield str(cluster.address)
    finally:
        cluster.shutdown()


def test_ray_with_a_task_that_is_killed(here: Path, ray: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RAY_ADDRESS", ray)
    example = (EXAMPLES / "10_parts_with_ray.py", "scene", "scene/words.npz", 3, "g.scoup")
    finished([sys.executable, *example], check=True)
    assert (here / "killed").exists()
    assert is_whole()


def kill_a_worker(folder: Path) -> bool:
    """Kill a worker of Ray that runs a task in a folder, if there is one."""
    for process in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            if (process / "cwd").readlink() == folder and b"ray::_run_here" in (
                process / "cmdline"
            ).read_bytes():
                os.kill(int(process.name), signal.SIGKILL)
                return True
    return False


def test_a_batch_on_ray_of_which_a_worker_is_killed(here: Path, ray: str) -> None:
    for name in "abc":
        shutil.copytree("scene", f"scans/{name}")
    batch = ("batch", "scans", "--model", "scene/words.npz", "--json", "--out")
    with child([sys.executable, "-m", "scoup", *batch, "fields", "--ray", ray]) as process:
        wait_for("a worker is killed", lambda: kill_a_worker(here) or process.poll() is not None)
        assert process.poll() is None
        out, err = process.communicate()
    assert process.returncode == 0, out + err
    assert json.loads(out)["failed"] == []
    assert run(*batch, "alone")[0] == 0
    for name in "abc":
        assert Path(f"fields/{name}.scoup").read_bytes() == Path(f"alone/{name}.scoup").read_bytes()
