"""The logits of the Adam solver that can matter, and Adam's state for them."""

from __future__ import annotations

import torch
from torch import Tensor

from scoup.coding.step import Step, add_gradient, decay

_START = 12
_GROW = 8
_TINY = 1e-30


class Slots:
    """Top-K logits of R rows: the trajectory of Adam over all [R, L] logits, at the cost of few of them.

    Only logits in the support (the K largest of a row) have gradients. A logit that was never in the support
    has zero moments, so it stays at its start until the support sinks to its level. Each row therefore keeps
    M slots: the M largest of its initial logits, support first. When the support of any row could reach the
    largest logit without a slot, all rows get more slots.

    Layout is [M, R], so that work over slots runs along contiguous rows.
    """

    def __init__(self, logits: Tensor, k: int) -> None:
        """Start from ``logits`` [R, L], with supports of ``k`` <= L atoms. Ties go to lower atoms."""
        self._k = k
        values, order = torch.sort(logits, dim=1, descending=True, stable=True)
        self._initial = values.T.contiguous()  # [L, R]
        self._order = order.T.contiguous()  # [L, R]
        shape = (0, logits.shape[0])
        self._logits = self._initial.new_zeros(shape)
        self._first = self._initial.new_zeros(shape)
        self._second = self._initial.new_zeros(shape)
        self._atoms = self._order.new_zeros(shape)
        self._widen(max(k, _START))

    @property
    def support(self) -> Tensor:
        """[K, R] int64: the atoms of each row with the K largest logits, in no particular order."""
        return self._atoms[: self._k]

    def weights(self) -> Tensor:
        """[K, R] float32: softmax over the support."""
        return torch.softmax(self._logits[: self._k], dim=0)

    def dense_logits(self) -> Tensor:
        """[R, L] float32: all logits, as dense Adam would hold them."""
        dense = torch.empty_like(self._initial).scatter_(0, self._order, self._initial)
        return dense.scatter_(0, self._atoms, self._logits).T

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
        lowest = self._logits[: self._k].amin(0)
        while self._width < len(self._initial) and bool((lowest < self._initial[self._width]).any()):
            self._widen(self._width + _GROW)
        if self._width == self._k:
            return False
        moved = (lowest < self._logits[self._k :].amax(0)).nonzero()[:, 0]
        if not len(moved):
            return False
        order = torch.sort(self._logits[:, moved], dim=0, descending=True, stable=True).indices
        for held in (self._logits, self._first, self._second, self._atoms):
            held[:, moved] = held[:, moved].gather(0, order)
        return True

    @property
    def _width(self) -> int:
        return self._logits.shape[0]

    def _widen(self, width: int) -> None:
        new = slice(self._width, min(width, len(self._initial)))
        zeros = torch.zeros_like(self._initial[new])
        self._logits = torch.cat([self._logits, self._initial[new]])
        self._first = torch.cat([self._first, zeros])
        self._second = torch.cat([self._second, zeros])
        self._atoms = torch.cat([self._atoms, self._order[new]])
