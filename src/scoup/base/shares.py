"""Equal parts of some work, of which each process does one."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

from scoup.base.errors import InputError

Item = TypeVar("Item")


@dataclass(frozen=True)
class Share:
    """One of several equal parts of some work."""

    number: int = 0  # from 0
    count: int = 1  # how many parts there are

    @classmethod
    def parse(cls, text: str) -> Share:
        """Return the share that "I/N" names, in which I counts from 1."""
        number, _, count = text.partition("/")
        if not (number.isdecimal() and count.isdecimal() and 1 <= int(number) <= int(count)):
            raise InputError(f"invalid shard {text!r}; expected I/N with 1 <= I <= N, such as 1/4")
        return cls(int(number) - 1, int(count))

    @classmethod
    def of_environment(cls) -> Share:
        """Return the share of this process among those that torchrun has started; everything without torchrun."""
        rank, world = os.environ.get("RANK", "0"), os.environ.get("WORLD_SIZE", "1")
        if not (rank.isdigit() and world.isdigit() and int(rank) < int(world)):
            raise InputError(f"RANK={rank} and WORLD_SIZE={world} are not a rank and a number of processes")
        return cls(int(rank), int(world))

    def __str__(self) -> str:
        return f"{self.number + 1}-of-{self.count}"

    @property
    def is_first(self) -> bool:
        return self.number == 0

    @property
    def is_everything(self) -> bool:
        return self.count == 1

    def of(self, items: Sequence[Item]) -> list[Item]:
        """Return every ``count``-th item, from the ``number``-th on."""
        return list(items[self.number :: self.count])


def device_of_process(device: str) -> str:
    """Return the GPU of this process's local rank under torchrun for "cuda"; other devices unchanged."""
    local = os.environ.get("LOCAL_RANK", "")
    return f"cuda:{local}" if device == "cuda" and local.isdigit() else device
