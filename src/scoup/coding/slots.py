"""Steps of Adam, and the logits of the Adam solver that have moved, with Adam's state for them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

BETAS = (0.9, 0.999)
EPSILON = 1e-8
_GROW = 4
_TINY = 1e-30


@dataclass(frozen=True)
class Step:
    """One step as torch.optim.Adam takes it (Kingma and Ba 2015, algorithm 1), bias-corrected:
    p -= size * m / (sqrt(v) / root + epsilon)."""

    size: float
    root: float

    @classmethod
    def of_epoch(cls, epoch: int, learning_rate: float) -> Step:
        """The step of epoch 1, 2, ..."""
        return cls(learning_rate / (1 - BETAS[0] ** epoch), math.sqrt(1 - BETAS[1] ** epoch))

    def move(self, parameter: Tensor, first: Tensor, second: Tensor) -> None:
        """Move ``parameter`` in place along its moments m = ``first`` and v = ``second`` of one shape."""
        parameter.addcdiv_(first, second.sqrt().div_(self.root).add_(EPSILON), value=-self.size)


def add_gradient(first: Tensor, second: Tensor, gradient: Tensor) -> None:
    """Add a gradient to moments that have decayed already, in place."""
    first.add_(gradient, alpha=1 - BETAS[0])
    second.addcmul_(gradient, gradient, value=1 - BETAS[1])


def decay(first: Tensor, second: Tensor) -> None:
    """Decay the moments by one epoch, in place."""
    first.mul_(BETAS[0])
    second.mul_(BETAS[1])


class Slots:
    """Top-K logits of R rows: the trajectory of Adam over all [R, L] logits, at the cost of few of them.

    Only logits in the support (the K largest of a row) have gradients. A logit that was never in the support
    has zero moments, so it stays at its start, and such logits enter in the order of their start: a row needs
    to compare with the next one only. It gives that one a slot when the support sinks below it.

    Layout is [M, R], so that work over slots runs along contiguous rows; the support stands first, slots that
    a row does not use yet hold -inf.
    """

    def __init__(self, logits: Tensor, k: int) -> None:
        """Start from ``logits`` [R, L], with supports of ``k`` <= L atoms. Ties go to lower atoms."""
        self._k = k
        values, order = torch.sort(logits, dim=1, descending=True, stable=True)
        # One row more, so that "the next logit" exists for a row that has taken all.
        self._initial = torch.nn.functional.pad(values.T, (0, 0, 0, 1), value=-torch.inf)  # [L + 1, R]
        self._order = torch.nn.functional.pad(order.T, (0, 0, 0, 1))  # [L + 1, R]
        self._used = torch.full_like(order[:, 0], k)  # [R] slots in use
        self._next = self._initial[k].clone()  # [R] the largest logit without a slot
        self._logits = self._initial[:k].clone()
        self._atoms = self._order[:k].clone()
        self._first = torch.zeros_like(self._logits)
        self._second = torch.zeros_like(self._logits)

    @property
    def support(self) -> Tensor:
        """[K, R] int64: the atoms of each row with the K largest logits, in no particular order."""
        return self._atoms[: self._k]

    def weights(self) -> Tensor:
        """[K, R]: softmax over the support."""
        return torch.softmax(self._logits[: self._k], dim=0)

    def step(self, gradient: Tensor, step: Step, flush: bool) -> None:
        """One Adam step from the gradient [K, R] of the support; the other slots coast on their moments.

        With ``flush`` moments that have decayed to nothing become zero, since arithmetic on denormal numbers
        is slow; what they would still have moved a logit is far below its rounding.
        """
        decay(self._first, self._second)
        add_gradient(self._first[: self._k], self._second[: self._k], gradient)
        if flush:
            self._first.masked_fill_(self._first.abs() < _TINY, 0.0)
            self._second.masked_fill_(self._second < _TINY, 0.0)
        step.move(self._logits, self._first, self._second)

    def settle(self) -> bool:
        """Bring the K largest logits of every row back to its first K slots; True if any support changed."""
        changed = False
        while True:
            lowest = self._logits[: self._k].amin(0)
            highest = self._next
            if len(self._logits) > self._k:
                highest = torch.maximum(highest, self._logits[self._k :].amax(0))
            moved = (lowest < highest).nonzero()[:, 0]
            if not len(moved):
                return changed
            changed = True
            self._admit(moved[self._next[moved] > lowest[moved]])
            self._exchange(moved)

    def _exchange(self, rows: Tensor) -> None:
        """Swap, in each of ``rows`` [n], the smallest logit of the support with the largest outside it."""
        values = self._logits.index_select(1, rows)
        leaving = values[: self._k].argmin(0)
        entering = values[self._k :].argmax(0) + self._k
        for held in (self._logits, self._first, self._second, self._atoms):
            old = held[leaving, rows]
            held[leaving, rows] = held[entering, rows]
            held[entering, rows] = old

    def _admit(self, rows: Tensor) -> None:
        """Give the next logit of each of ``rows`` [n] a slot."""
        if not len(rows):
            return
        slot = self._used[rows]
        missing = int(slot.max()) + 1 - len(self._logits)
        if missing > 0:
            self._grow(max(missing, _GROW))
        self._logits[slot, rows] = self._next[rows]
        self._atoms[slot, rows] = self._order[slot, rows]
        self._used[rows] = slot + 1
        self._next[rows] = self._initial[slot + 1, rows]

    def _grow(self, count: int) -> None:
        below = (0, 0, 0, count)
        self._logits = torch.nn.functional.pad(self._logits, below, value=-torch.inf)
        self._atoms = torch.nn.functional.pad(self._atoms, below)
        self._first = torch.nn.functional.pad(self._first, below)
        self._second = torch.nn.functional.pad(self._second, below)
