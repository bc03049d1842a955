"""Coding in plain torch: the readable specification of the faster backend.

The coder works in Gram space and in float64, batched over rows. Rounding may depend on the number of threads.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from scoup.coding.backends import RowCodes
from scoup.coding.least_squares import DEPENDENT, identity_outside, nonnegative_least_squares
from scoup.scene import float32_products

NO_GAIN = 1e-9  # share of the explained square below which another atom is rounding
SWAP_GAIN = 1e-6  # share by which a swap must raise the explained square
_BLOCK_NUMBERS = 1 << 21  # numbers of one temporary of ``code_rows``
_BLOCK_ROWS = 4096  # of the sums of ``code_moments``


def code(
    similarities: Tensor,  # [n, L]
    gram: Tensor,  # [L, L]
    k: int,
    swap_passes: int = 0,
    warm: Tensor | None = None,  # [n, K] supports to start from, -1 for none; atoms may repeat
) -> RowCodes:
    """Return at most k atoms and weights >= 0 per row that bring the decoded code close to it in angle.

    Under the cosine loss only the direction of w C matters, so the best weights on a support solve non-negative
    least squares, which needs only s = C f and G = C C^T. The support is found greedily by orthogonal least squares
    (Chen, Billings and Luo 1989), then each atom in turn is exchanged for another wherever that helps, in at most
    ``swap_passes`` rounds.
    """
    problem = _Problem(similarities.double(), gram.double())
    solution = problem.solve(problem.choose(k) if warm is None else warm.long())
    for _ in range(swap_passes):
        before = solution.explained
        for slot in range(k):
            solution = problem.swap(solution, slot)
        if bool((solution.explained == before).all()):
            break
    weights, order = torch.sort(solution.weights, dim=1, descending=True, stable=True)
    return RowCodes(solution.support.gather(1, order), weights, solution.explained.clamp(min=0).sqrt())


def code_rows(
    rows: Tensor,  # [R, D]
    atoms: Tensor,  # [L, D]
    k: int,
    swap_passes: int = 0,
    warm: Tensor | None = None,  # [R, K]
) -> RowCodes:
    """See ``CodingBackend.code_rows``."""
    size = max(1, _BLOCK_NUMBERS // (k * len(atoms)))
    gram = float32_products(atoms, atoms)
    coded = []
    for start in range(0, max(1, len(rows)), size):
        block = slice(start, start + size)
        similarities = float32_products(rows[block], atoms)
        coded.append(code(similarities, gram, k, swap_passes, None if warm is None else warm[block]))
    support, weights, cosines = (torch.cat(parts) for parts in zip(*coded, strict=True))
    return RowCodes(support.int(), weights.float(), cosines.float())


def row_products(rows: Tensor, others: Tensor) -> Tensor:
    """See ``CodingBackend.row_products``."""
    return float32_products(rows, others)


def code_moments(rows: Tensor, codes: RowCodes, scale: Tensor, n_atoms: int) -> tuple[Tensor, Tensor]:
    """See ``CodingBackend.code_moments``."""
    within = rows.new_zeros(n_atoms, n_atoms, dtype=torch.float64)
    toward = rows.new_zeros(n_atoms, rows.shape[1], dtype=torch.float64)
    for first in range(0, len(rows), _BLOCK_ROWS):
        block = slice(first, first + _BLOCK_ROWS)
        # An extra column takes the unused slots.
        support = codes.support[block].long()
        dense = rows.new_zeros(len(support), n_atoms + 1)
        dense.scatter_(1, support.where(support >= 0, n_atoms), codes.weights[block])
        dense = dense[:, :n_atoms]
        scaled = (dense * scale[block, None]).T
        within += float32_products(scaled, dense.T)
        toward += float32_products(scaled, rows[block].T)
    return within, toward


def solve(matrix: Tensor, right: Tensor) -> Tensor:
    """See ``CodingBackend.solve``."""
    return torch.linalg.solve(matrix, right)


class _Solution(NamedTuple):
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

    def solve(self, support: Tensor) -> _Solution:
        """Non-negative least squares on the support; atoms without weight are dropped."""
        atoms = support.clamp(min=0)
        toward = torch.where(support >= 0, self.similarities.gather(1, atoms), 0.0)
        within = self.gram[atoms[:, :, None], atoms[:, None, :]]
        weights = nonnegative_least_squares(toward, within, support >= 0)
        order = (weights <= 0).long().sort(dim=1, stable=True).indices  # used slots first
        support = torch.where(weights > 0, support, -1).gather(1, order)
        return _Solution(support, weights.gather(1, order), (weights * toward).sum(1))

    def swap(self, solution: _Solution, slot: int) -> _Solution:
        """Exchange the atom of one slot for a better one, where there is one; or fill the first unused slot."""
        used = solution.support >= 0
        atoms = solution.support.clamp(min=0)
        rows = self.gram[atoms] * used[:, :, None]  # [n, K, L]
        within = identity_outside(self.gram[atoms[:, :, None], atoms[:, None, :]], used)
        copies = torch.linalg.solve(within, rows)  # weights of the support in the copy of each atom
        residual = self.similarities - (solution.weights[:, :, None] * rows).sum(1)
        left = self.norms - (copies * rows).sum(1)
        # Atoms in the support have no residual.
        in_support = torch.zeros_like(left).scatter_add_(1, atoms, used.to(left.dtype)) > 0
        residual, left = residual.masked_fill(in_support, 0.0), left.masked_fill(in_support, 0.0)

        # With M = within^-1, removing atom i gives back w_i / M_ii of its copies to the residuals, and 1 / M_ii of
        # their squares to the norms left.
        back = (1 / torch.linalg.inv(within).diagonal(dim1=1, dim2=2)[:, slot]) * used[:, slot]
        lost = solution.weights[:, slot] ** 2 * back
        copy = copies[:, slot]
        residual = residual + (solution.weights[:, slot] * back)[:, None] * copy
        left = left + back[:, None] * copy**2
        others = in_support & (atoms[:, slot, None] != torch.arange(len(self.gram), device=atoms.device))
        gain, pick = self._gains(residual, left.masked_fill(others, 0.0)).max(1)

        enough = solution.explained * (1 + SWAP_GAIN)
        tries = (slot <= used.sum(1)) & (solution.explained - lost + gain > enough)
        chosen = tries.nonzero()[:, 0]
        if len(chosen) == 0:
            return solution
        support = solution.support[chosen].clone()
        support[:, slot] = pick[chosen]
        other = _Problem(self.similarities[chosen], self.gram).solve(support)
        better = other.explained > enough[chosen]
        result = _Solution(*(tensor.clone() for tensor in solution))
        for target, source in zip(result, other, strict=True):
            target[chosen[better]] = source[better]
        return result

    def _gains(self, residual: Tensor, left: Tensor) -> Tensor:
        usable = (left > DEPENDENT * self.norms) & (residual > 0)
        return torch.where(usable, residual**2 / left, 0.0)
