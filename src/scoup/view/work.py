"""A queue for the work of several visitors on one field; work that nobody waits for any more is dropped."""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import anyio

Result = TypeVar("Result")

MOST_WAITING = 64
_MOST_VISITORS = 1024  # whose last picture is remembered


class BusyError(Exception):
    """Too much is waiting already."""


class SupersededError(Exception):
    """The visitor has asked for a newer picture."""


class Work:
    """Runs functions in one thread, one at a time, in the order they came.

    It is always the same thread, and no other does such work: what the system keeps of a thread's freed memory is as
    much as the largest piece of work needed, and would be that for each of several threads.
    """

    def __init__(self) -> None:
        self._limiter = anyio.CapacityLimiter(1)
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="scoup view work")
        self._newest: OrderedDict[str, int] = OrderedDict()
        self._count = 0

    def begin(self, function: Callable[[], object]) -> None:
        """Run a function before all others, with nobody to wait for it; what it raises is lost."""
        self._thread.submit(function)

    async def run(self, function: Callable[[], Result]) -> Result:
        """Return the result of a function.

        Raises:
            BusyError: ``MOST_WAITING`` others wait.
        """
        if self._limiter.statistics().tasks_waiting >= MOST_WAITING:
            raise BusyError
        async with self._limiter:
            return await asyncio.wrap_future(self._thread.submit(function))

    async def run_newest(self, visitor: str, function: Callable[[], Result]) -> Result:
        """Return the result of a function, unless the visitor sends a newer request before its turn.

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
