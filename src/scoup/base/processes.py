"""Several processes at one task, as torchrun starts them: who does what, and how their parts come together."""

from __future__ import annotations

import ctypes
import os
import pickle
import re
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any, TypeVar, cast

import torch

from scoup.base.errors import SAID_ELSEWHERE, InputError, ProcessLostError

Item = TypeVar("Item")

SILENCE = 60.0
"""Seconds after which a process that gives no sign of life counts as lost."""
_BEAT = 1.0  # seconds between signs of life
_POLL = 0.1


@dataclass(frozen=True)
class Processes:
    """This process among those at work.

    Attributes:
        rank: its number, from 0.
        world: how many there are.
    """

    rank: int = 0
    world: int = 1

    @property
    def first(self) -> bool:
        """Whether this is the one that writes files."""
        return self.rank == 0

    def share(self, items: Sequence[Item]) -> list[Item]:
        """Every world-th of the items: this process's part."""
        return list(items[self.rank :: self.world])

    def share_range(self, count: int) -> range:
        """This process's part of 0 .. count - 1, one after another; ranks follow each other."""
        return range(self.rank * count // self.world, (self.rank + 1) * count // self.world)

    def owner(self, position: int) -> int:
        """The rank to whose ``share`` the item at a position belongs."""
        return position % self.world

    def from_rank(self, item: Item | None, rank: int) -> Item:
        """The item of one process, on each."""
        items = [item]
        if self.world > 1:
            with _losses_named():
                torch.distributed.broadcast_object_list(items, rank)
        assert items[0] is not None
        return items[0]

    def of_first(self, work: Callable[[], Item]) -> Item:
        """What the first process's work gives, on each; where it raises an error, each raises it.

        Args:
            work: done by the first process alone.
        """
        found: Item | None = None
        error: Exception | None = None
        if self.first:
            try:
                found = work()
            except Exception as caught:
                error = caught
        if self.world > 1:
            found, said = self.from_rank((found, _sendable(error)), 0)
            error = error or said
        if error is not None:
            raise error
        return cast(Item, found)

    def gather(self, item: Item) -> list[Item]:
        """Everybody's item, on each process, by rank."""
        if self.world == 1:
            return [item]
        items: list[Item] = [item] * self.world
        with _losses_named():
            torch.distributed.all_gather_object(items, item)
        return items


def _sendable(error: Exception | None) -> Exception | None:
    """The error, or one that says the same where it cannot be sent to another process."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return RuntimeError(f"{type(error).__name__}: {error}")
    return error


ALONE = Processes()


def at_work() -> Processes:
    """The processes of torch's process group; this one alone where there is none."""
    if torch.distributed.is_available() and torch.distributed.is_initialized():
        return Processes(torch.distributed.get_rank(), torch.distributed.get_world_size())
    return Processes()


def of_environment() -> Processes:
    """The processes that torchrun has started; this one alone without it. They need not be in touch.

    Raises:
        InputError: its variables make no sense.
    """
    rank, world = os.environ.get("RANK", "0"), os.environ.get("WORLD_SIZE", "1")
    if not (rank.isdigit() and world.isdigit() and int(rank) < int(world)):
        raise InputError(f"RANK={rank} and WORLD_SIZE={world} are no rank and number of processes")
    return Processes(int(rank), int(world))


def shard(text: str) -> Processes:
    """One of several processes that need not be in touch, from "I/N": I counts from 1.

    Raises:
        InputError: it is no such text.
    """
    number, _, count = text.partition("/")
    if not (number.isdecimal() and count.isdecimal() and 1 <= int(number) <= int(count)):
        raise InputError(f"{text!r} is no shard; give I/N with I from 1 to N, such as 1/4")
    return Processes(int(number) - 1, int(count))


def device_of_process(device: str) -> str:
    """ "cuda" becomes the GPU of this process's local rank under torchrun; other devices stay as they are."""
    local = os.environ.get("LOCAL_RANK", "")
    return f"cuda:{local}" if device == "cuda" and local.isdigit() else device


@contextmanager
def process_group(device: str) -> Iterator[Processes]:
    """Put the processes that torchrun has started in touch; nothing happens without it.

    Args:
        device: what this process works on, from ``device_of_process``.
    """
    processes = of_environment()
    if processes.world == 1:
        yield processes
        return
    if not torch.distributed.is_available():
        raise InputError("this torch cannot let several processes work together; run without torchrun")
    if device.startswith("cuda"):
        torch.cuda.set_device(device)
    backend = "cpu:gloo,cuda:nccl" if device.startswith("cuda") else "gloo"
    try:
        with _losses_named(), _nothing_on_stdout():
            meeting = torch.distributed.rendezvous("env://")  # pyright: ignore[reportPrivateImportUsage]
            store, rank, world = next(meeting)
            torch.distributed.init_process_group(backend, store=store, rank=rank, world_size=world)
    except ValueError as error:  # a variable is missing
        raise InputError(f"the processes cannot meet ({error}); start them with torchrun") from error
    try:
        yield processes
    except (ProcessLostError, KeyboardInterrupt) as error:
        setattr(error, SAID_ELSEWHERE, not _is_first_to_say(store))
        raise
    finally:
        torch.distributed.destroy_process_group()


@contextmanager
def _nothing_on_stdout() -> Iterator[None]:
    """Of what libraries print: gloo, before torch 2.11, says who has met, amid our JSON."""
    sys.stdout.flush()
    kept, nowhere = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    try:
        yield
    finally:
        if os.name == "posix":
            ctypes.CDLL(None).fflush(None)  # what they would print later
        os.dup2(kept, 1)
        os.close(kept)
        os.close(nowhere)


@contextmanager
def signs_of_life(processes: Processes) -> Iterator[Callable[[], None]]:
    """For processes in touch whose work may take any time: give signs of life meanwhile.

    Yields:
        To be called once by each: returns when each has called it. It can be interrupted, which a collective of torch
        cannot, and raises ProcessLostError when one of them has given no sign for ``SILENCE`` seconds.
    """
    if processes.world == 1:
        yield lambda: None
        return
    store = torch.distributed.distributed_c10d._get_default_store()
    ended = threading.Event()

    def beat() -> None:
        with suppress(RuntimeError):  # whoever waits learns that the store is gone, too
            while not ended.wait(_BEAT):
                store.add(f"scoup beat {processes.rank}", 1)

    thread = threading.Thread(target=beat, daemon=True)
    thread.start()
    try:
        yield lambda: _wait_for_all(processes, store)
    finally:
        ended.set()
        thread.join()


def _wait_for_all(processes: Processes, store: Any) -> None:
    heard: dict[int, tuple[int, float]] = {}  # beats, and when their number was last another
    with _losses_named():
        store.set(f"scoup here {processes.rank}", "")
        while missing := [i for i in range(processes.world) if not store.check([f"scoup here {i}"])]:
            for i in missing:
                beats = store.add(f"scoup beat {i}", 0)
                if i not in heard or beats != heard[i][0]:
                    heard[i] = beats, time.monotonic()
                elif time.monotonic() - heard[i][1] > SILENCE:
                    raise ProcessLostError(f"no sign of life of number {i} for {SILENCE:.0f} s")
            time.sleep(_POLL)


def _is_first_to_say(store: Any) -> bool:
    try:
        return store.add(SAID_ELSEWHERE, 1) == 1
    except RuntimeError:  # it has ended with the process that was lost
        return True


@contextmanager
def _losses_named() -> Iterator[None]:
    """What torch raises when a process cannot be reached, as an error for the user."""
    try:
        yield
    except RuntimeError as error:
        said = str(error)
        if "allocate" in said or "out of memory" in said:
            raise
        # From the last line of a trace of C++, what stands after the source file.
        raise ProcessLostError(re.sub(r"^\[.*?\] *", "", said.splitlines()[0])) from error
