"""Several processes at one build or merge: one of them dies, or is in another network."""

from __future__ import annotations

import subprocess
import uuid
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path

import pytest
import torch

from cli_support import QUICK, run, together
from scoup.uplift.region_sums import RegionSums
from support import environments

pytestmark = pytest.mark.usefixtures("here")
DIES = """
import os, signal
from scoup.cli.app import entry
from scoup.uplift.region_sums import RegionSums
append = RegionSums.append
def die(self, *arguments):
    append(self, *arguments)
    if os.environ["RANK"] == os.environ["DIES"] and len(self) == 1:
        os.kill(os.getpid(), signal.SIGKILL)
RegionSums.append = die
entry()
"""
DIES_AT_CODING = """
import os, signal
from scoup.cli.app import entry
from scoup.uplift import region_codes
learn = region_codes.fit_codes
def die(*arguments, **options):
    if os.environ["RANK"] == os.environ["DIES"]:
        os.kill(os.getpid(), signal.SIGKILL)
    return learn(*arguments, **options)
region_codes.fit_codes = die
entry()
"""
BUILD = ("build", "scene", *QUICK, "--out", "g.scoup", "--model", "scene/words.npz")


def check_one_message(ended: Sequence[subprocess.CompletedProcess[str]], dies: int) -> None:
    """One process was killed, the others end, and one of them says why."""
    assert [done.returncode for done in ended] == [-9 if rank == dies else 1 for rank in range(len(ended))]
    errors = "".join(done.stderr for done in ended)
    said = [line for line in errors.splitlines() if line.startswith("error: ")]
    assert len(said) == 1, said
    assert "another of the processes at work together has ended" in said[0]
    assert "Traceback" not in errors


@pytest.mark.parametrize("dies", [0, pytest.param(2, marks=pytest.mark.slow)])
def test_a_process_that_dies_ends_all_with_one_message(dies: int) -> None:
    """What is done is kept, and the same command goes on from there."""
    with environments(3) as ranks:
        ended = together([{**rank, "DIES": str(dies)} for rank in ranks], *BUILD, program=DIES)
    check_one_message(ended, dies)
    partial = sorted(Path().glob("g.scoup.partial.*"))
    assert len(partial) == 3
    assert not Path("g.scoup").exists()
    views = [len(RegionSums.open(path)) for path in partial]
    assert views[dies] == 1
    assert sum(views) >= 3

    with environments(3) as ranks:
        ended = together(ranks, *BUILD)
    assert [done.returncode for done in ended] == [0, 0, 0], ended
    assert Path("g.scoup").read_bytes() == Path("f.scoup").read_bytes()
    assert not list(Path().glob("g.scoup.*"))


def test_a_process_that_dies_ends_a_merge() -> None:
    """Nothing is left of it but its shards."""
    for number in (1, 2):
        assert (
            run("build", "scene", "--model", "scene/words.npz", "--out", "g.scoup", "--shard", f"{number}/2")[
                0
            ]
            == 0
        )
    shards = sorted(Path().glob("g.scoup.*"))
    with environments(2) as ranks:
        ended = together(
            [{**rank, "DIES": "1"} for rank in ranks], "merge", *shards, *QUICK, program=DIES_AT_CODING
        )
    check_one_message(ended, 1)
    assert sorted(Path().glob("*g.scoup*")) == shards
    assert run("merge", *shards, *QUICK)[0] == 0
    assert Path("g.scoup").read_bytes() == Path("f.scoup").read_bytes()


@pytest.fixture
def other_network() -> Iterator[tuple[str, list[str], str, str]]:
    """Our address on a link to another network, how to start something there, and the names of the link's ends."""
    number = uuid.uuid4()
    name = f"scoup{number.hex[:6]}"
    here, there = f"{name}a", f"{name}b"
    network = f"10.199.{number.int % 256}"  # a run that was killed may have left one
    commands = [
        f"netns add {name}",
        f"link add {here} type veth peer name {there} netns {name}",
        f"addr add {network}.1/30 dev {here}",
        f"link set {here} up",
        f"-n {name} addr add {network}.2/30 dev {there}",
        f"-n {name} link set {there} up",
        f"-n {name} link set lo up",
    ]
    with ExitStack() as stack:
        for command in commands:
            try:
                done = subprocess.run(["ip", *command.split()], capture_output=True, text=True)
            except FileNotFoundError:
                pytest.skip("there is no program ip (iproute2)")
            if done.returncode:
                pytest.skip(f"no network of its own can be made here: ip {command}: {done.stderr.strip()}")
            if command.startswith("netns"):
                stack.callback(subprocess.run, ["ip", "netns", "del", name], check=True)
        yield f"{network}.1", ["ip", "netns", "exec", name], here, there


def test_a_process_in_another_network(other_network: tuple[str, list[str], str, str]) -> None:
    address, prefix, here, there = other_network
    store = torch.distributed.TCPStore(  # pyright: ignore[reportPrivateImportUsage]
        address, 0, is_master=True, wait_for_workers=False
    )
    shared = {
        "WORLD_SIZE": "2",
        "MASTER_ADDR": address,
        "MASTER_PORT": str(store.port),
        "TORCHELASTIC_USE_AGENT_STORE": "True",
        "TORCHELASTIC_RESTART_COUNT": "0",
    }
    ranks = [
        {**shared, "RANK": "0", "GLOO_SOCKET_IFNAME": here},
        {**shared, "RANK": "1", "GLOO_SOCKET_IFNAME": there},
    ]
    ended = together(ranks, *BUILD, prefixes=[(), prefix])
    assert [done.returncode for done in ended] == [0, 0], ended
    assert Path("g.scoup").read_bytes() == Path("f.scoup").read_bytes()


def test_processes_that_cannot_meet_are_told_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RANK", "0")
    monkeypatch.setenv("WORLD_SIZE", "2")
    for name in ("MASTER_ADDR", "MASTER_PORT"):
        monkeypatch.delenv(name, raising=False)
    code, _, err = run(*BUILD)
    assert code == 2
    assert "start them with torchrun" in err
