"""Spherical k-means: the starting codebook."""

from __future__ import annotations

import torch
from torch import Tensor

SAMPLE = 16384  # rows used to choose the start; Lloyd iterations use all rows
TRIALS = 4
ITERATIONS = 10


def spherical_kmeans(
    rows: Tensor,  # [R, D]
    n_atoms: int,
    seed: int = 0,
    iterations: int = ITERATIONS,
) -> Tensor:
    """Return unit-norm cluster centres [L, D] of unit rows, by cosine distance; deterministic for a seed.

    The start is greedy k-means++ (Arthur and Vassilvitskii 2007, with the best of 4 candidates per step), then Lloyd
    iterations until no row changes its cluster; a cluster that loses all its rows is moved to the row that is worst
    represented. With fewer distinct rows than atoms some atoms are equal.
    """
    generator = torch.Generator().manual_seed(seed)
    sample = rows
    if len(rows) > SAMPLE:
        chosen = torch.randperm(len(rows), generator=generator)[:SAMPLE].sort().values
        sample = rows[chosen.to(rows.device)]
    atoms = _plus_plus(sample, n_atoms, generator)
    previous = None
    for _ in range(iterations):
        best, nearest = (rows @ atoms.T).max(1)
        if previous is not None and torch.equal(nearest, previous):
            break
        previous = nearest
        atoms = _centres(rows, nearest, best, atoms)
    return atoms


def _plus_plus(rows: Tensor, n_atoms: int, generator: torch.Generator) -> Tensor:
    first = int(torch.randint(len(rows), (1,), generator=generator))
    chosen = [first]
    distance = _distance(rows, rows[first : first + 1])[:, 0]
    while len(chosen) < n_atoms:
        # Draws in float64 on the CPU, so that every device picks the same rows.
        cumulative = distance.double().cpu().cumsum(0)
        draws = torch.rand(TRIALS, generator=generator, dtype=torch.float64)
        if cumulative[-1] > 0:
            picks = torch.searchsorted(cumulative, draws * cumulative[-1], right=True).clamp_(
                max=len(rows) - 1
            )
        else:  # every row is already an atom
            picks = (draws * len(rows)).long()
        reduced = torch.minimum(distance[:, None], _distance(rows, rows[picks.to(rows.device)]))
        winner = int(reduced.sum(0).argmin())
        chosen.append(int(picks[winner]))
        distance = reduced[:, winner].contiguous()
    return rows[torch.tensor(chosen, device=rows.device)].clone()


def _distance(rows: Tensor, centres: Tensor) -> Tensor:
    """Return [R, C] 1 - cosine, half the squared distance of unit vectors; exactly 0 for rows equal up to rounding."""
    distance = 1 - rows @ centres.T
    return torch.where(distance > 1e-6, distance, 0.0)


def _centres(rows: Tensor, nearest: Tensor, best: Tensor, atoms: Tensor) -> Tensor:
    # A product with the one-hot matrix rather than index_add_, which is not deterministic on a GPU.
    members = torch.zeros(len(atoms), len(rows), dtype=rows.dtype, device=rows.device)
    members.scatter_(0, nearest[None], 1.0)
    sums = members @ rows
    norms = torch.linalg.vector_norm(sums, dim=1, keepdim=True)
    atoms = torch.where(norms > 1e-6, sums / norms.clamp(min=1e-6), atoms)
    empty = (members.sum(1) == 0).nonzero()[:, 0]
    if len(empty):
        worst = torch.sort(best, stable=True)
        taken = worst.indices[: len(empty)]
        # Rows that an atom already stands for need no second one.
        useful = worst.values[: len(empty)] < 1 - 1e-6
        atoms[empty[: len(taken)][useful]] = rows[taken[useful]]
    return atoms
