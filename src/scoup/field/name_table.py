"""Names of things: the texts that a model looked for, and its votes for things."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import torch
from torch import Tensor

from scoup.base import InputError, brief
from scoup.field.checks import MOST_THINGS, NAMES, check_names, tensor_array


def number_of(texts: Iterable[str], text: str) -> int | None:
    """Return the position of a text among others, whatever its capitals; None if it is not there."""
    same = text.casefold()
    return next((number for number, each in enumerate(texts) if each.casefold() == same), None)


@dataclass(frozen=True, eq=False)
class NameTable:
    """M texts that a model looked for in photographs, and E votes of what it found for things."""

    texts: tuple[str, ...]  # M different ones
    presence: Tensor  # [M] float32, 0 to 1: how sure it is that the photographs show them
    rows: Tensor  # [E] int32, position of the text of each vote
    things: Tensor  # [E] int32, number of the thing
    votes: Tensor  # [E] float32, 0 to 1: mean over views of score times overlap of thing and detection

    __repr__ = brief

    def __post_init__(self) -> None:
        if len(set(self.texts)) < len(self.texts):
            raise InputError("two names of things are one text")
        self.check(MOST_THINGS)

    def check(self, count: int) -> None:
        """Refuse parts that do not fit together, and names of things beyond ``count``."""
        parts = (tensor_array(part) for part in (self.presence, self.rows, self.things, self.votes))
        check_names(dict(zip(NAMES, parts, strict=True)), {"M": len(self.texts), "T": count})

    def __len__(self) -> int:
        return len(self.texts)

    def number(self, text: str) -> int | None:
        """Return the position of a text, whatever its capitals; None if it was not looked for."""
        return number_of(self.texts, text)

    def votes_of(self, number: int, count: int) -> Tensor:
        """Return the votes of one text for each of ``count`` things, [count] float32."""
        mine = self.rows == number
        return torch.zeros(count).index_put_((self.things[mine].long(),), self.votes[mine])

    def matrix(self, count: int) -> Tensor:
        """Return the votes of all texts, [count, M] float32."""
        found = torch.zeros(count, len(self))
        found[self.things.long(), self.rows.long()] = self.votes
        return found

    def joined(self, newer: NameTable) -> NameTable:
        """Return both tables as one; texts of both are those of the newer one."""
        kept = [number for number, text in enumerate(self.texts) if newer.number(text) is None]
        place = torch.full((len(self),), -1, dtype=torch.int32)
        place[kept] = torch.arange(len(kept), dtype=torch.int32)
        rows = place[self.rows.long()]
        mine = rows >= 0
        return NameTable(
            (*(self.texts[number] for number in kept), *newer.texts),
            torch.cat([self.presence[kept], newer.presence]),
            torch.cat([rows[mine], newer.rows + len(kept)]),
            torch.cat([self.things[mine], newer.things]),
            torch.cat([self.votes[mine], newer.votes]),
        )
