"""Spherical k-means on a sample of the rows: the starting codebook."""

from __future__ import annotations

import torch
from torch import Tensor

from scoup.coding.arithmetic import ordered_sum, take_rows, unit
from scoup.coding.backends import CodingBackend, RowCodes

SAMPLE = 4000  # rows used
TRIALS = 4
_SAME = 1e-6  # 1 - cosine under which two rows are the same


def spherical_kmeans(
    rows: Tensor,  # [R, D]
    n_atoms: int,
    random: torch.Generator,
    backend: CodingBackend,
    iterations: int,
) -> Tensor:
    """Return unit cluster centres [L, D] of unit rows on the CPU, by cosine distance.

    The start is greedy k-means++ (Arthur and Vassilvitskii 2007, the best of 4 candidates a step) on a sample of the
    rows; iterations of Lloyd follow. A cluster that loses all its rows is moved to the row that is worst represented.
    With fewer distinct rows than atoms some atoms are equal.
    """
    sample = rows
    if len(rows) > SAMPLE:
        chosen = torch.randperm(len(rows), generator=random)[:SAMPLE].sort().values
        sample = take_rows(rows, chosen)
    atoms = sample[_plus_plus(sample, n_atoms, random, backend)]
    for _ in range(iterations):
        atoms = _lloyd(sample, atoms, backend)
    return atoms


def _plus_plus(rows: Tensor, n_atoms: int, random: torch.Generator, backend: CodingBackend) -> list[int]:
    chosen = [int(torch.randint(len(rows), (1,), generator=random))]
    distance = _distances(rows, chosen, backend)[:, 0]
    while len(chosen) < n_atoms:
        cumulative = distance.double().cumsum(0)
        draws = torch.rand(TRIALS, generator=random, dtype=torch.float64)
        if cumulative[-1] > 0:
            picks = torch.searchsorted(cumulative, draws * cumulative[-1], right=True)
            picks.clamp_(max=len(rows) - 1)
        else:  # every row is already an atom
            picks = (draws * len(rows)).long()
        reduced = torch.minimum(distance[:, None], _distances(rows, picks.tolist(), backend))
        winner = int(ordered_sum(reduced.double(), 0).argmin())
        chosen.append(int(picks[winner]))
        distance = reduced[:, winner]
    return chosen


def _distances(rows: Tensor, picks: list[int], backend: CodingBackend) -> Tensor:
    """[R, P]: 1 - cosine to some of the rows, exactly 0 for equal rows."""
    distance = 1 - backend.row_products(rows, rows[picks])
    return torch.nn.functional.threshold(distance, _SAME, 0.0)


def _lloyd(rows: Tensor, atoms: Tensor, backend: CodingBackend) -> Tensor:
    best, nearest = backend.row_products(rows, atoms).max(1)
    ones = torch.ones_like(best)
    members = RowCodes(nearest.int()[:, None], ones[:, None], ones)
    _, sums = backend.code_moments(rows, members, ones, len(atoms))
    atoms = unit(sums.float(), atoms)
    empty = (torch.bincount(nearest, minlength=len(atoms)) == 0).nonzero()[:, 0]
    worst = best.argsort(stable=True)[: len(empty)]
    # A row equal to an atom needs no second atom.
    useful = best[worst] < 1 - _SAME
    atoms[empty[: len(worst)][useful]] = rows[worst[useful]]
    return atoms
