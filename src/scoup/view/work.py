"""The work of several visitors on one field: one piece after another, none that nobody waits for."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from functools import partial
from typing import TypeVar

import anyio
import anyio.to_thread

from scoup.base.freed_memory import give_back_freed_memory

Result = TypeVar("Result")

MOST_WAITING = 64
_MOST_VISITORS = 1024  # whose last picture is remembered
_GIVEN_BACK_EVERY = 100  # pieces of work, after which freed memory goes back to the system


class BusyError(Exception):
    """Too much is waiting already."""


class SupersededError(Exception):
    """The visitor has asked for a newer picture."""


class Work:
    """Runs functions in a thread, one at a time, in the order they came."""

    def __init__(self) -> None:
        self._limiter = anyio.CapacityLimiter(1)
        self._newest: OrderedDict[str, int] = OrderedDict()
        self._count = 0
        self._pieces = 0

    async def run(self, function: Callable[[], Result]) -> Result:
        """What a function gives.

        Raises:
            BusyError: ``MOST_WAITING`` others wait.
        """
        if self._limiter.statistics().tasks_waiting >= MOST_WAITING:
            raise BusyError
        return await anyio.to_thread.run_sync(partial(self._done, function), limiter=self._limiter)

    def _done(self, function: Callable[[], Result]) -> Result:
        self._pieces += 1
        if self._pieces % _GIVEN_BACK_EVERY == 0:
            give_back_freed_memory()
        return function()

    async def run_newest(self, visitor: str, function: Callable[[], Result]) -> Result:
        """The same, unless the visitor comes with a newer one before its turn.

        Raises:
            BusyError: as ``run``.
            SupersededError: it did.
        """
        self._count += 1
        number = self._count
        self._newest[visitor] = number
        self._newest.move_to_end(visitor)
        if len(self._newest) > _MOST_VISITORS:
            self._newest.popitem(last=False)

        def unless_superseded() -> Result:
            if self._newest.get(visitor, number) != number:
                raise SupersededError
            return function()

        return await self.run(unless_superseded)
