"""Several processes at one build, as torchrun starts them."""

from __future__ import annotations

import socket
from multiprocessing import get_context
from pathlib import Path

import pytest
import torch

from scoup import LanguageField, build
from scoup.errors import InputError
from scoup.processes import Processes, device_of_process, of_environment, process_group
from support import small_scene


def test_shares_are_everything_once() -> None:
    items = list(range(11))
    shares = [Processes(rank, 4).share(items) for rank in range(4)]
    assert sorted(item for share in shares for item in share) == items
    assert max(map(len, shares)) - min(map(len, shares)) <= 1


def test_the_environment_of_torchrun(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("RANK", "WORLD_SIZE", "LOCAL_RANK"):
        monkeypatch.delenv(name, raising=False)
    assert of_environment() == Processes(0, 1)
    assert device_of_process("cuda") == "cuda"
    monkeypatch.setenv("RANK", "5")
    monkeypatch.setenv("WORLD_SIZE", "8")
    monkeypatch.setenv("LOCAL_RANK", "1")
    assert of_environment() == Processes(5, 8)
    assert device_of_process("cuda") == "cuda:1"
    assert device_of_process("cuda:3") == "cuda:3"
    assert device_of_process("cpu") == "cpu"
    monkeypatch.setenv("RANK", "8")
    with pytest.raises(InputError, match="WORLD_SIZE"):
        of_environment()


def build_in_process(rank: int, world: int, port: int, folder: Path) -> None:
    """One of several processes."""
    import os

    os.environ |= {
        "RANK": str(rank),
        "WORLD_SIZE": str(world),
        "MASTER_ADDR": "localhost",
        "MASTER_PORT": str(port),
    }
    torch.set_num_threads(1)
    gaussians, cameras, regions = small_scene(views=5)
    with process_group("cpu") as processes:
        assert processes == Processes(rank, world)
        field = build(
            gaussians, cameras, regions, n_atoms=8, k=3, keep_accumulators=True, checkpoint=folder / "partial"
        )
    field.save(folder / f"{rank}.scoup")


def build_together(world: int, folder: Path) -> list[LanguageField]:
    with socket.socket() as probe:
        probe.bind(("localhost", 0))
        port = probe.getsockname()[1]
    spawn = get_context("spawn")
    workers = [
        spawn.Process(target=build_in_process, args=(rank, world, port, folder)) for rank in range(world)
    ]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join(120)
        assert worker.exitcode == 0
    gaussians, _, _ = small_scene(views=5)
    return [LanguageField.load(folder / f"{rank}.scoup", gaussians) for rank in range(world)]


def test_two_processes_build_what_one_builds(tmp_path: Path) -> None:
    gaussians, cameras, regions = small_scene(views=5)
    alone = build(gaussians, cameras, regions, n_atoms=8, k=3, keep_accumulators=True)
    fields = build_together(2, tmp_path)
    assert torch.equal(fields[0].code_weights, fields[1].code_weights)
    assert torch.equal(fields[0].code_indices, fields[1].code_indices)
    assert fields[0].info.provenance["views"] == alone.info.provenance["views"]
    assert fields[0].info.provenance["label_maps"] == alone.info.provenance["label_maps"]
    for field in fields:
        assert torch.equal(field.codebook, alone.codebook)
        # The second round holds to the first's float32 sums, which are added up in another order.
        torch.testing.assert_close(field.accumulators, alone.accumulators, rtol=1e-3, atol=1e-4)


def test_what_one_process_has_begun_counts_once(tmp_path: Path) -> None:
    """A single process is interrupted in the middle of a round; two go on from its state."""
    from scoup import checkpoint

    gaussians, cameras, regions = small_scene(views=5)
    alone = build(gaussians, cameras, regions, n_atoms=8, k=3, keep_accumulators=True)
    seconds, checkpoint.SECONDS_BETWEEN_WRITES = checkpoint.SECONDS_BETWEEN_WRITES, 0.0

    def interrupt(stage: str, done: int, total: int) -> None:
        if stage == "uplift" and done == 3:
            raise KeyboardInterrupt

    try:
        with pytest.raises(KeyboardInterrupt):
            build(
                gaussians,
                cameras,
                regions,
                n_atoms=8,
                k=3,
                keep_accumulators=True,
                checkpoint=tmp_path / "partial",
                progress=interrupt,
            )
    finally:
        checkpoint.SECONDS_BETWEEN_WRITES = seconds
    assert (tmp_path / "partial").exists()
    for field in build_together(2, tmp_path):
        torch.testing.assert_close(field.accumulators, alone.accumulators, rtol=1e-3, atol=1e-4)
