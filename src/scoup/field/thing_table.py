"""Instances of a scene: what regions of many views are one thing, and which Gaussians belong to it."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from scoup.base import InputError, brief
from scoup.field.checks import MOST_THINGS, NAMES, THINGS_IN_MEMORY, check_names, check_things, tensor_array

NO_THING = -1
"""The owner of a Gaussian that belongs to no thing of a level; also the parent of a thing without one."""
LEAST_SPREAD = 1e-3
"""Of the cosines of a thing's regions with a text; things whose regions are all equal would have none."""
SURE_REGIONS = 3
"""Things of fewer regions say nothing about how far regions of one thing differ."""


@dataclass(frozen=True, eq=False)
class ThingTable:
    """The T instances of all levels."""

    # [N, S] int32, the thing that each Gaussian belongs to at each level; ``NO_THING`` for none
    owners: Tensor
    levels: Tensor  # [T] uint8, position of the level of each thing, rising
    # [T] int32, the thing of the next coarser level that contains most of it; ``NO_THING`` for none
    parents: Tensor
    embeddings: Tensor  # [T, D] float16, mean embedding of its regions, unit norm
    # [T] float32, norm of the mean of its regions' unit embeddings: 1 if they are all equal
    agreement: Tensor
    n_regions: Tensor  # [T] int32, how many regions it was merged from
    mass: Tensor  # [T] float32, what the Gaussians that decided what is merged contribute to its regions
    # [T] float32, how consistently the views that see it segment it: the mean IoU of its regions with what it has in
    # each other view, 0 in views where it has no region
    stability: Tensor
    names: NameTable | None = None  # given by an open-vocabulary detector

    __repr__ = brief

    def __post_init__(self) -> None:
        arrays = {f"things.{name}": tensor_array(getattr(self, name)) for name in TENSORS}
        sides: dict[str, int] = {}
        check_things(arrays, sides, THINGS_IN_MEMORY)
        if self.names is not None:
            self.names.check(sides["T"])

    def __len__(self) -> int:
        return len(self.levels)

    @cached_property
    def owned(self) -> Tensor:
        """[S, N] boolean, the Gaussians that belong to a thing of each level."""
        return (self.owners != NO_THING).T.contiguous()

    @property
    def spread(self) -> float:
        """Return ``cosine_spread`` of its things."""
        return cosine_spread(self.agreement, self.n_regions, self.embeddings.shape[1])

    def members(self, things: Tensor) -> Tensor:
        """Return [N] boolean: the Gaussians of some things [M] of one level."""
        chosen = torch.zeros(len(self) + 1, dtype=torch.bool, device=self.owners.device)
        chosen[things.long().to(chosen.device) + 1] = True  # the first means none
        level = int(self.levels[things[0]]) if len(things) else 0
        return chosen.index_select(0, self.owners[:, level] + 1)

    def parts(self, thing: int) -> Tensor:
        """Return a thing with its parts and theirs, [T] boolean on the CPU."""
        parents = self.parents.long().cpu()
        members = torch.arange(len(self)) == thing
        for _ in range(1, self.owners.shape[1]):
            members |= (parents != NO_THING) & members[parents]
        return members

    def sums(self, weights: Tensor) -> Tensor:
        """Return [T] float64: the sum of weights [N] over the Gaussians of each thing."""
        weights = weights.cpu()
        gaussians = torch.from_numpy(np.flatnonzero(weights.numpy()))  # few, as a rule
        owners = self.owners[gaussians.to(self.owners.device)].cpu() + 1
        totals, weights = torch.zeros(len(self) + 1, dtype=torch.float64), weights[gaussians].double()
        for of_level in owners.T:  # numbers of other levels own nothing there
            totals += torch.bincount(of_level, weights, len(self) + 1)
        return totals[1:]

    def rows(self, chosen: Tensor) -> ThingTable:
        """Return the things of some of the Gaussians; all things stay, those left without a Gaussian too."""
        return replace(self, owners=self.owners[chosen])

    def to(self, device: torch.device | str) -> ThingTable:
        moved = {name: getattr(self, name).to(device) for name in TENSORS}
        return replace(self, **moved)  # names stay: they are small, and used on the CPU


def cosine_spread(agreement: Tensor, n_regions: Tensor, dim: int) -> float:
    """Return how far the cosines of one thing's regions with a text differ, in the median thing merged from enough
    regions.

    A region's embedding lies about sqrt(1 - agreement^2) from its thing's mean, in any of the D directions, one of
    which is the text's.
    """
    sure = agreement[n_regions >= SURE_REGIONS]
    median = float((sure if len(sure) else agreement.new_ones(1)).median())
    return max(LEAST_SPREAD, math.sqrt(max(0.0, 1.0 - median * median) / max(1, dim)))


TENSORS = tuple(attribute.name for attribute in fields(ThingTable) if attribute.name != "names")
"""The attributes of a table that are tensors."""


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
        parts = (tensor_array(tensor) for tensor in (self.presence, self.rows, self.things, self.votes))
        check_names(dict(zip(NAMES, parts, strict=True)), {"M": len(self.texts), "T": count})

    def __len__(self) -> int:
        return len(self.texts)

    def number(self, text: str) -> int | None:
        """Return the position of a text, whatever its capitals; None if it was not looked for."""
        same = text.casefold()
        return next((number for number, other in enumerate(self.texts) if other.casefold() == same), None)

    def votes_of(self, number: int, count: int) -> Tensor:
        """Return the votes of one text for each of ``count`` things, [count] float32."""
        chosen = self.rows == number
        return torch.zeros(count).index_put_((self.things[chosen].long(),), self.votes[chosen])

    def matrix(self, count: int) -> Tensor:
        """Return the votes of all texts, [count, M] float32."""
        matrix = torch.zeros(count, len(self))
        matrix[self.things.long(), self.rows.long()] = self.votes
        return matrix

    def joined(self, newer: NameTable) -> NameTable:
        """Return both tables as one; texts of both are those of the newer one."""
        retained = [number for number, text in enumerate(self.texts) if newer.number(text) is None]
        new_rows = torch.full((len(self),), -1, dtype=torch.int32)
        new_rows[retained] = torch.arange(len(retained), dtype=torch.int32)
        rows = new_rows[self.rows.long()]
        valid = rows >= 0
        return NameTable(
            (*(self.texts[number] for number in retained), *newer.texts),
            torch.cat([self.presence[retained], newer.presence]),
            torch.cat([rows[valid], newer.rows + len(retained)]),
            torch.cat([self.things[valid], newer.things]),
            torch.cat([self.votes[valid], newer.votes]),
        )
