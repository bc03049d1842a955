"""scoup build in several processes, as torchrun starts them: each makes a shard, the first merges them."""

from __future__ import annotations

import os
import shlex
import shutil
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from cli_support import QUICK, RUN, run, snapshot, together, write_scene
from scoup.base.locks import locked_output
from scoup.uplift.region_sums import RegionSums
from support import HANGS, environments

pytestmark = pytest.mark.usefixtures("quick_python")

SCENE = ("scene", "--model", "scene/words.npz")
BUILD = ("build", *SCENE, *QUICK, "--out", "g.scoup")
# Others than the one that ends soon notice that.
IMPATIENT = """
import os, signal
from scoup.base import heartbeats
from scoup.cli.app import entry
heartbeats.SILENCE, heartbeats._BEAT = 3, 0.3
"""
DIES = (
    IMPATIENT
    + """
from scoup.uplift.region_sums import RegionSums
append = RegionSums.append
def die(self, *arguments):
    append(self, *arguments)
    if os.environ["RANK"] == os.environ["DIES"] and len(self) == 1:
        os.kill(os.getpid(), signal.SIGKILL)
RegionSums.append = die
entry()
"""
)
# The first finds the disk full where it writes the field ...
FULL = """
import errno
import safetensors.torch
from scoup.cli.app import entry
def full(tensors, path, *_):
    raise OSError(errno.ENOSPC, "No space left on device", str(path))
safetensors.torch.save_file = full
entry()
"""
# ... or fails where it compares renders with photographs, when the second has seen that it is there.
FAILS = """
import time
from pathlib import Path
from scoup.cli.app import entry
from scoup.uplift import fit
def fails(*_):
    lock = Path("g.scoup.2-of-2.sums.lock")
    while not (lock.exists() and "ready_for" in lock.read_text()):
        time.sleep(0.1)
    raise ValueError("of the first")
fit.measure_fit = fails
entry()
"""


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a scene and its field with region sums, ``alone.scoup``, built by one process."""
    folder = tmp_path_factory.mktemp("several")
    write_scene(folder / "scene", count=1200)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert run("build", *SCENE, *QUICK, "--keep-sums", "--out", "alone.scoup")[0] == 0
    return folder


def is_whole() -> bool:
    """Whether the field is that of one process, and nothing else is left."""
    left = {path.name for path in Path().iterdir()} - {"alone.scoup", "alone.scoup.sums", "scene"}
    return left == {"g.scoup"} and Path("g.scoup").read_bytes() == Path("alone.scoup").read_bytes()


def built(world: int, *arguments: str, code: int = 0) -> list[subprocess.CompletedProcess[str]]:
    ended = together(environments(world), *(arguments or BUILD))
    assert [done.returncode for done in ended] == [code] * world, ended
    return ended


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize("world", [2, 3, 5])
def test_the_bytes_of_one_process(world: int) -> None:
    """Also where there are more processes than views."""
    ended = built(world)
    assert [done.stderr for done in ended] == [""] * world
    assert [done.stdout.count("coded, built in") for done in ended] == [1] + [0] * (world - 1)
    assert is_whole()


@pytest.mark.usefixtures("here")
def test_sums_that_are_kept() -> None:
    built(2, *BUILD, "--keep-sums")
    assert snapshot(Path("g.scoup.sums")) == snapshot(Path("alone.scoup.sums"))


@pytest.mark.usefixtures("here")
def test_what_needs_one_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RANK", "0")
    monkeypatch.setenv("WORLD_SIZE", "2")
    for arguments, said in {
        ("merge", "alone.scoup.sums", *QUICK, "--out", "k.scoup"): "works in one process",
        (*BUILD, "--sums", "alone.scoup.sums"): "--sums needs one process",
        (*BUILD, "--shard", "1/4"): "not both",
        tuple(
            shlex.split("extract scene --segmenter felzenszwalb --embedder colors --shard 1/4")
        ): "not both",
    }.items():
        code, _, err = run(*arguments)
        assert (code, err.count("\n")) == (2, 1), err
        assert said in err


@pytest.mark.usefixtures("here")
def test_an_output_in_use_is_refused() -> None:
    before = set(Path().iterdir())
    with locked_output(Path("g.scoup")):
        first, second = together(environments(2), *BUILD, program=IMPATIENT + "entry()")
    assert first.returncode == 2
    assert f"error: g.scoup: is being written by process {os.getpid()} on " in first.stderr
    assert second.returncode == 1  # torchrun would end it at once
    assert set(Path().iterdir()) - before == {Path("g.scoup.2-of-2.sums")}
    built(2)
    assert is_whole()


@pytest.mark.usefixtures("here")
def test_none_gives_up_its_views_before_the_field_is_there() -> None:
    first, second = together(environments(2), *BUILD, program=FULL)
    assert (first.returncode, second.returncode) == (2, 1)
    assert first.stderr.startswith("error: g.scoup: cannot be written (No space left on device)")
    assert second.stderr == ""
    for number in (1, 2):
        assert len(RegionSums.open(Path(f"g.scoup.{number}-of-2.sums"))) == 2
    for done in built(2):
        assert "2 of 2 views are done" in done.stdout
    assert is_whole()


@pytest.mark.usefixtures("here")
def test_all_end_with_the_error_of_the_first() -> None:
    first, second = together(environments(2), *BUILD, program=FAILS)
    assert (first.returncode, second.returncode) == (1, 1)
    assert "ValueError: of the first" in first.stderr
    assert second.stderr == ""


@pytest.mark.usefixtures("here")
def test_shards_of_an_earlier_scene_are_not_taken() -> None:
    shutil.move("scene", "now")
    write_scene(Path("scene"), count=1200, seed=1)
    for number in (1, 2):
        assert run("build", *SCENE, "--out", "g.scoup", "--shard", f"{number}/2")[0] == 0
    shutil.rmtree("scene")
    shutil.move("now", "scene")
    for done in built(2):
        assert "cannot be continued" in done.stderr
    assert is_whole()


def check_one_message(ended: Sequence[subprocess.CompletedProcess[str]], dies: int) -> None:
    """One process was killed, the others end, and one of them says why."""
    assert [done.returncode for done in ended] == [-9 if rank == dies else 1 for rank in range(len(ended))]
    errors = "".join(done.stderr for done in ended)
    said = [line for line in errors.splitlines() if line.startswith("error: ")]
    assert len(said) == 1, said
    assert "another of the processes at work together has ended" in said[0]
    assert "Traceback" not in errors


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize("dies", [0, pytest.param(2, marks=pytest.mark.slow)])
def test_a_process_that_dies_ends_all_with_one_message(dies: int) -> None:
    """What is done is kept, and the same command continues from there."""
    ended = together([{**rank, "DIES": str(dies)} for rank in environments(3)], *BUILD, program=DIES)
    check_one_message(ended, dies)
    assert not Path("g.scoup").exists()
    for rank in range(3):
        path = Path(f"g.scoup.{rank + 1}-of-3.sums{'.partial' if rank == dies else ''}")
        assert len(RegionSums.open(path)) >= 1
    built(3)
    assert is_whole()


@pytest.mark.usefixtures("here")
def test_a_process_that_waits_can_be_interrupted() -> None:
    command = [sys.executable, "-c", RUN, *BUILD]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", **environments(2)[0]}
    with subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True) as first:
        while not Path("g.scoup.1-of-2.sums").exists() and first.poll() is None:
            pass
        first.send_signal(signal.SIGINT)
        _, err = first.communicate(timeout=HANGS)
    assert first.returncode == 130
    assert err == "error: interrupted; 2 of 2 views are kept, run the same command again to continue\n"
    built(2)
    assert is_whole()
