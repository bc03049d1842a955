"""Work in a loop: its progress, its equal parts for several processes, and items made ahead by threads."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from scoup.base.errors import InputError
from scoup.base.outputs import check_output, locked, make_folder

Item = TypeVar("Item")
Result = TypeVar("Result")

Progress = Callable[[str, int, int], None]
"""``progress(stage, done, total)``: called with done = 0 before the first step and after every step."""


def no_progress(stage: str, done: int, total: int) -> None:
    """Report nothing."""


def reported(items: Iterable[Item], stage: str, total: int, progress: Progress) -> Iterator[Item]:
    """Yield items as they come; each counts as done when the next one is requested."""
    progress(stage, 0, total)
    for done, item in enumerate(items, start=1):
        yield item
        progress(stage, done, total)


def worked_ahead(
    work: Callable[[Item], Result], items: Iterable[Item], threads: int
) -> Generator[tuple[Item, Future[Result]], None, None]:
    """Yield items with the futures of ``work``, in order. Beside the one that was yielded last, at most ``threads``
    results are there or being made."""
    waiting: deque[tuple[Item, Future[Result]]] = deque()
    with ThreadPoolExecutor(threads) as pool:
        try:
            for item in items:
                waiting.append((item, pool.submit(work, item)))
                if len(waiting) > threads:
                    yield waiting.popleft()
            while waiting:
                yield waiting.popleft()
        finally:
            for _, future in waiting:
                future.cancel()


@dataclass(frozen=True)
class Part:
    """One of several equal parts of some work."""

    number: int = 1
    """Of this part, from 1."""
    count: int = 1
    """Of all parts."""

    @classmethod
    def parse(cls, text: str) -> Part:
        """Return the part that "I/N" names, in which I counts from 1.

        Example:
            >>> from scoup.base import Part
            >>> Part.parse("2/3").of("abcdefg")
            ['b', 'e']
        """
        number, _, count = text.partition("/")
        if not (number.isdecimal() and count.isdecimal() and 1 <= int(number) <= int(count)):
            raise InputError(f"invalid part {text!r}; expected I/N with 1 <= I <= N, such as 1/4")
        return cls(int(number), int(count))

    def __str__(self) -> str:
        return f"{self.number}-of-{self.count}"

    def of(self, items: Sequence[Item]) -> list[Item]:
        """Return every ``count``-th item, from the ``number``-th on."""
        return list(items[self.number - 1 :: self.count])

    @contextmanager
    def reserved(self, folder: Path) -> Iterator[None]:
        """Keep other processes from making the same part of a folder; the folder is made if it is missing."""
        if folder.is_file():
            raise InputError(f"{folder}: is a file, not a folder; choose another output")
        check_output(folder / f"part-{self}", overwrite=True)
        make_folder(folder, folder)
        with locked(folder / f"part-{self}"):
            yield
