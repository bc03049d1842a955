"""Exact sparse coding in Gram space, in plain torch: what the compiled coder computes, written to be read.

Everything is batched over rows and in float64. It is the oracle of the compiled coder and of the GPU's, and stands in
for them where there is neither.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from scoup.scene.codes import full_products

DEPENDENT = 1e-5  # an atom with less than this share of its squared norm left depends on those chosen
NO_GAIN = 1e-9  # share of the explained square below which another atom is rounding
SWAP_GAIN = 1e-6  # share by which a swap must raise the explained square
NO_WEIGHT = 1e-7  # weights below this share of the largest possible are rounding
_BLOCK_NUMBERS = 1 << 21  # numbers of one temporary of ``code_rows``


class Coded(NamedTuple):
    """Codes of n rows. Weights are those of least squares; the norm of a decoded code is the cosine of a unit
    row and its code.
    """

    support: Tensor  # [n, K] int64 by falling weight, -1 in slots that are not used
    weights: Tensor  # [n, K] float64
    cosines: Tensor  # [n] float64


def code(
    similarities: Tensor,  # [n, L]
    gram: Tensor,  # [L, L]
    k: int,
    swap_passes: int = 0,
    warm: Tensor | None = None,  # [n, K]
) -> Coded:
    """For each row at most k atoms and weights >= 0 that bring the decoded code near to it in angle.

    Under the cosine loss only the direction of w C matters, so the best weights on a support solve non-negative
    least squares, which needs only s = C f and G = C C^T. The support is found greedily by orthogonal least squares
    (Chen, Billings and Luo 1989), then each atom in turn is exchanged for another wherever that helps.

    Args:
        similarities: inner products of rows and atoms, any float dtype.
        gram: inner products of the atoms.
        k: most atoms of a code.
        swap_passes: rounds of exchanges at most.
        warm: supports to start from in place of the greedy choice, -1 for none; atoms may repeat.
    """
    problem = _Problem(similarities.double(), gram.double())
    found = problem.solve(problem.choose(k) if warm is None else warm.long())
    for _ in range(swap_passes):
        before = found.explained
        for slot in range(k):
            found = problem.swap(found, slot)
        if bool((found.explained == before).all()):
            break
    weights, order = torch.sort(found.weights, dim=1, descending=True, stable=True)
    return Coded(found.support.gather(1, order), weights, found.explained.clamp(min=0).sqrt())


def code_rows(
    rows: Tensor,  # [R, D]
    atoms: Tensor,  # [L, D]
    k: int,
    swap_passes: int = 0,
    warm: Tensor | None = None,  # [R, K]
) -> Coded:
    """``code`` of rows under atoms, in blocks of rows, so that memory does not grow with R x L."""
    size = max(1, _BLOCK_NUMBERS // (k * len(atoms)))
    return code_in_blocks(
        lambda similarities, gram, start: code(similarities, gram, k, swap_passes, start),
        rows,
        atoms,
        size,
        warm,
    )


def code_in_blocks(
    coder: Callable[[Tensor, Tensor, Tensor | None], Coded],
    rows: Tensor,  # [R, D]
    atoms: Tensor,  # [L, D]
    size: int,
    warm: Tensor | None,  # [R, K]
) -> Coded:
    """Codes of rows, ``size`` rows at a time, by ``coder(similarities [n, L], gram [L, L], warm [n, K] or None)``."""
    gram = full_products(atoms, atoms)
    coded = []
    for start in range(0, max(1, len(rows)), size):
        block = slice(start, start + size)
        similarities = full_products(rows[block], atoms)
        coded.append(coder(similarities, gram, None if warm is None else warm[block]))
    return Coded(*(torch.cat(parts) for parts in zip(*coded, strict=True)))


class _Found(NamedTuple):
    support: Tensor  # [n, K], used slots first, then -1
    weights: Tensor  # [n, K]
    explained: Tensor  # [n] squared norm of the decoded code, w . s


class _Problem:
    def __init__(self, similarities: Tensor, gram: Tensor) -> None:
        self.similarities = similarities
        self.gram = gram
        self.norms = gram.diagonal()

    def choose(self, k: int) -> Tensor:
        """Greedy orthogonal least squares with positive residuals only: [n, K], -1 once no atom helps."""
        residual = self.similarities  # of each atom with what is left of the row
        left = self.norms.expand_as(residual)  # squared norm of each atom, less what the chosen atoms span
        directions: list[Tensor] = []  # [n, L] each: Gram rows of the orthogonalised atoms
        support = []
        enough = None
        for _ in range(min(k, len(self.gram))):
            gain, pick = self._gains(residual, left).max(1, keepdim=True)
            enough = NO_GAIN * gain if enough is None else enough
            chosen = gain > enough
            direction = self.gram[pick[:, 0]]
            for earlier in directions:
                direction = direction - earlier.gather(1, pick) * earlier
            root = left.gather(1, pick).clamp(min=torch.finfo(left.dtype).tiny).sqrt()
            direction = torch.where(chosen, direction / root, 0.0)
            residual = residual - residual.gather(1, pick) / root * direction
            left = (left - direction**2).scatter(1, pick, 0.0)
            directions.append(direction)
            support.append(torch.where(chosen, pick, -1))
        missing = [torch.full_like(support[0], -1)] * (k - len(support))
        return torch.cat(support + missing, 1)

    def solve(self, support: Tensor) -> _Found:
        """Non-negative least squares on the support; atoms without weight are dropped."""
        atoms = support.clamp(min=0)
        toward = torch.where(support >= 0, self.similarities.gather(1, atoms), 0.0)
        within = self.gram[atoms[:, :, None], atoms[:, None, :]]
        weights = nonnegative_least_squares(toward, within, support >= 0)
        order = (weights <= 0).long().sort(dim=1, stable=True).indices  # used slots first
        support = torch.where(weights > 0, support, -1).gather(1, order)
        return _Found(support, weights.gather(1, order), (weights * toward).sum(1))

    def swap(self, found: _Found, slot: int) -> _Found:
        """Exchange the atom of one slot for a better one, where there is one; or fill the first unused slot."""
        used = found.support >= 0
        atoms = found.support.clamp(min=0)
        rows = self.gram[atoms] * used[:, :, None]  # [n, K, L]
        within = _identity_outside(self.gram[atoms[:, :, None], atoms[:, None, :]], used)
        copies = torch.linalg.solve(within, rows)  # weights of the support in the copy of each atom
        residual = self.similarities - (found.weights[:, :, None] * rows).sum(1)
        left = self.norms - (copies * rows).sum(1)
        # Beside its own support no atom has anything left.
        own = torch.zeros_like(left).scatter_add_(1, atoms, used.to(left.dtype)) > 0
        residual, left = residual.masked_fill(own, 0.0), left.masked_fill(own, 0.0)

        # With M = within^-1, removing atom i gives back w_i / M_ii of its copies to the residuals, and 1 / M_ii of
        # their squares to the norms left.
        back = (1 / torch.linalg.inv(within).diagonal(dim1=1, dim2=2)[:, slot]) * used[:, slot]
        lost = found.weights[:, slot] ** 2 * back
        copy = copies[:, slot]
        residual = residual + (found.weights[:, slot] * back)[:, None] * copy
        left = left + back[:, None] * copy**2
        others = own & (atoms[:, slot, None] != torch.arange(len(self.gram), device=atoms.device))
        gain, pick = self._gains(residual, left.masked_fill(others, 0.0)).max(1)

        enough = found.explained * (1 + SWAP_GAIN)
        tries = (slot <= used.sum(1)) & (found.explained - lost + gain > enough)
        chosen = tries.nonzero()[:, 0]
        if len(chosen) == 0:
            return found
        support = found.support[chosen].clone()
        support[:, slot] = pick[chosen]
        other = _Problem(self.similarities[chosen], self.gram).solve(support)
        better = other.explained > enough[chosen]
        result = _Found(*(part.clone() for part in found))
        for mine, theirs in zip(result, other, strict=True):
            mine[chosen[better]] = theirs[better]
        return result

    def _gains(self, residual: Tensor, left: Tensor) -> Tensor:
        usable = (left > DEPENDENT * self.norms) & (residual > 0)
        return torch.where(usable, residual**2 / left, 0.0)


def nonnegative_least_squares(
    toward: Tensor,  # [n, K]
    within: Tensor,  # [n, K, K]
    valid: Tensor,  # [n, K]
) -> Tensor:
    """[n, K]: the w >= 0 that minimise w^T within w - 2 w . toward, zero outside ``valid`` and for atoms that depend
    on others.

    Where the solution without signs is positive it is the answer; elsewhere the active-set method of Lawson and
    Hanson (Solving Least Squares Problems, 1974, chapter 23) finds it.
    """
    norms = within.diagonal(dim1=1, dim2=2)
    alone = torch.where(valid & (norms > 0), toward / norms, 0.0)
    smallest = NO_WEIGHT * alone.amax(1, keepdim=True).clamp(min=0)
    weights, independent = _least_squares(toward, within, valid)
    rest = (~(independent & ((weights > smallest) | ~valid).all(1))).nonzero()[:, 0]
    if len(rest):
        weights[rest] = _active_set(toward[rest], within[rest], valid[rest], smallest[rest])
    return weights


def _active_set(toward: Tensor, within: Tensor, valid: Tensor, smallest: Tensor) -> Tensor:
    norms = within.diagonal(dim1=1, dim2=2)
    weights = torch.zeros_like(toward)
    used = torch.zeros_like(valid)
    barred = ~valid
    for _ in range(4 * valid.shape[1]):
        pull = toward - (within @ weights[:, :, None])[:, :, 0]
        helps = ~used & ~barred & (pull > smallest * norms) & (pull > 0)
        if not bool(helps.any()):
            break
        steepest = torch.where(helps, pull, -torch.inf).argmax(1, keepdim=True)
        enters = torch.zeros_like(used).scatter_(1, steepest, True) & helps
        target, independent = _least_squares(toward, within, used | enters)
        useless = ~independent | (target.gather(1, steepest) <= smallest)[:, 0]
        barred |= enters & useless[:, None]
        moving = enters.any(1) & ~useless
        used |= enters & moving[:, None]
        while bool(moving.any()):
            target, _ = _least_squares(toward, within, used)
            falls = used & (target <= 0)
            step = torch.where(falls, weights / (weights - target), 1.0).amin(1, keepdim=True)
            moved = weights + step * (target - weights)
            keeps = used & ((step == 1) | (moved > smallest))
            weights = torch.where(moving[:, None], torch.where(keeps, moved, 0.0), weights)
            dropped = (keeps != used).any(1)
            used = torch.where(moving[:, None], keeps, used)
            moving &= dropped
    return weights


def _least_squares(toward: Tensor, within: Tensor, active: Tensor) -> tuple[Tensor, Tensor]:
    """Weights [n, K], zero outside ``active``, and whether the active atoms are independent [n]."""
    factor, info = torch.linalg.cholesky_ex(_identity_outside(within, active))
    norms = torch.where(active, within.diagonal(dim1=1, dim2=2), 1.0)
    pivots = factor.diagonal(dim1=1, dim2=2) ** 2
    independent = (info == 0) & (pivots > DEPENDENT * norms).all(1)
    identity = torch.eye(toward.shape[1], dtype=toward.dtype, device=toward.device)
    factor = torch.where(independent[:, None, None], factor, identity)
    weights = torch.cholesky_solve(torch.where(active, toward, 0.0)[:, :, None], factor)[:, :, 0]
    return weights, independent


def _identity_outside(within: Tensor, active: Tensor) -> Tensor:
    both = active[:, :, None] & active[:, None, :]
    return torch.where(both, within, torch.eye(active.shape[1], dtype=within.dtype, device=within.device))
