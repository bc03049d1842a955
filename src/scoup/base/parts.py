"""Equal parts of some work, of which each process does one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

from scoup.base.errors import InputError

Item = TypeVar("Item")


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
            >>> from scoup.base.parts import Part
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
