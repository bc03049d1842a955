"""Several processes at one build, as torchrun starts them."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch

from scoup import BuildSettings, LanguageField, build
from scoup.base.errors import InputError, OutputExistsError
from scoup.base.processes import Processes, device_of_process, of_environment, process_group
from scoup.uplift.rasterise import region_sums, resumed
from support import HANGS, environments, ready_processes, small_scene

SETTINGS = BuildSettings(n_atoms=8, k=3)


def test_shares_are_everything_once() -> None:
    items = list(range(11))
    shares = [Processes(rank, 4).share(items) for rank in range(4)]
    assert sorted(item for share in shares for item in share) == items
    assert max(map(len, shares)) - min(map(len, shares)) <= 1
    for position, item in enumerate(items):
        assert item in shares[Processes(0, 4).owner(position)]
    ranges = [Processes(rank, 4).share_range(11) for rank in range(4)]
    assert [item for part in ranges for item in part] == items


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


def join(environment: dict[str, str]) -> None:
    """Make this process one of several."""
    os.environ |= environment
    torch.set_num_threads(1)


def build_in_process(rank: int, environment: dict[str, str], folder: Path) -> None:
    """One of several processes."""
    join(environment)
    gaussians, cameras, regions = small_scene(count=700, views=5)
    with process_group("cpu") as processes:
        assert processes == Processes(rank, int(environment["WORLD_SIZE"]))
        sums = resumed(folder / f"partial.{rank}", gaussians, regions)
        field = build(gaussians, cameras, regions, settings=SETTINGS, sums=sums)
    field.save(folder / f"{rank}.scoup")


def refused_in_process(rank: int, environment: dict[str, str], folder: Path) -> None:
    """One of several processes whose cameras see nothing; writes the error, and what it had rasterised by then."""
    join(environment)
    gaussians, cameras, regions = small_scene(count=50, views=5)
    gaussians.means[:, 2] -= 1000
    with process_group("cpu"):
        sums = resumed(folder / f"partial.{rank}", gaussians, regions)
        try:
            build(gaussians, cameras, regions, settings=SETTINGS, sums=sums)
        except InputError as error:
            (folder / f"{rank}.txt").write_text(f"{len(sums)} {error}")


class Unsendable(ValueError):
    """Pickled by the text alone, which is not what it is made of."""

    def __init__(self, one: int, other: int) -> None:
        super().__init__(f"{one} and {other}")


def first_in_process(rank: int, environment: dict[str, str], folder: Path) -> None:
    """One of several processes; writes what the first has found, and the errors it has raised."""
    join(environment)

    def fail(error: Exception) -> None:
        raise error

    with process_group("cpu") as processes:
        said = [str(processes.of_first(lambda: f"found by {rank}"))]
        for error in (OutputExistsError("a.scoup"), OSError(5, "Input/output error", "a"), Unsendable(1, 2)):
            try:
                processes.of_first(lambda error=error: fail(error))
            except Exception as caught:
                said.append(f"{caught}")
    (folder / f"{rank}.txt").write_text("\n".join(said))


def test_what_the_first_finds_or_raises_is_everybodys(tmp_path: Path) -> None:
    run_together(first_in_process, 2, tmp_path)
    assert (tmp_path / "0.txt").read_text() == "\n".join(
        ["found by 0", str(OutputExistsError("a.scoup")), "[Errno 5] Input/output error: 'a'", "1 and 2"]
    )
    first, second = ((tmp_path / f"{rank}.txt").read_text() for rank in range(2))
    assert second == first.replace("1 and 2", "Unsendable: 1 and 2")


def test_alone_the_first_finds_and_raises_itself() -> None:
    assert Processes().of_first(lambda: 5) == 5
    with pytest.raises(ZeroDivisionError):
        Processes().of_first(lambda: 1 // 0)


def run_together(work: Callable[[int, dict[str, str], Path], None], world: int, folder: Path) -> None:
    context: Any = ready_processes()
    with environments(world) as ranks:
        workers = [
            context.Process(target=work, args=(rank, environment, folder))
            for rank, environment in enumerate(ranks)
        ]
        for worker in workers:
            worker.start()
        for worker in workers:
            worker.join(HANGS)
            assert worker.exitcode == 0


def build_together(world: int, folder: Path) -> list[LanguageField]:
    run_together(build_in_process, world, folder)
    gaussians, _, _ = small_scene(count=700, views=5)
    return [LanguageField.load(folder / f"{rank}.scoup", gaussians) for rank in range(world)]


@pytest.mark.parametrize("world", [2, pytest.param(3, marks=pytest.mark.slow)])
def test_several_processes_build_what_one_builds(tmp_path: Path, world: int) -> None:
    """To the byte: each votes for its share of the Gaussians, with the sums of all."""
    gaussians, cameras, regions = small_scene(count=700, views=5)
    build(gaussians, cameras, regions, settings=SETTINGS).save(tmp_path / "alone.scoup")
    build_together(world, tmp_path)
    for rank in range(world):
        assert (tmp_path / f"{rank}.scoup").read_bytes() == (tmp_path / "alone.scoup").read_bytes()


def test_all_processes_refuse_what_does_not_fit(tmp_path: Path) -> None:
    run_together(refused_in_process, 2, tmp_path)
    said = [(tmp_path / f"{rank}.txt").read_text() for rank in range(2)]
    assert said[0] == said[1]
    assert said[0].startswith("0 the splat does not fit the cameras: 5 of 5 cameras tried see nothing")


def test_what_a_process_has_added_counts_once(tmp_path: Path) -> None:
    """The views in a process's file are not rasterised again, whoever's share they are."""
    gaussians, cameras, regions = small_scene(count=700, views=5)
    build(gaussians, cameras, regions, settings=SETTINGS).save(tmp_path / "alone.scoup")
    region_sums(gaussians, cameras[:3], regions, path=tmp_path / "partial.0").close()
    build_together(2, tmp_path)
    for rank in range(2):
        assert (tmp_path / f"{rank}.scoup").read_bytes() == (tmp_path / "alone.scoup").read_bytes()
