"""The starting codebook of the exact solver: spherical k-means on a sample of the rows.

``kmeans`` is the same idea in torch, for any device and all rows. This form runs on the exact solver's arithmetic, so
that the start does not depend on the number of threads either.
"""

from __future__ import annotations

import numpy as np
import torch

from scoup.coding.arithmetic import Arithmetic, Floats, RowCodes

SAMPLE = 4000  # rows looked at
TRIALS = 4
ITERATIONS = 2
_SAME = 1e-6  # 1 - cosine under which two rows are the same


def starting_atoms(rows: Floats, n_atoms: int, random: torch.Generator, arithmetic: Arithmetic) -> Floats:
    """[L, D] unit vectors: greedy k-means++ (Arthur and Vassilvitskii 2007, the best of 4 candidates a step) on a
    sample of the unit rows [R, D], then Lloyd iterations. With fewer distinct rows than atoms some atoms are equal.
    """
    sample = rows
    if len(rows) > SAMPLE:
        sample = rows[torch.randperm(len(rows), generator=random)[:SAMPLE].sort().values.numpy()]
    atoms = sample[_plus_plus(sample, n_atoms, random, arithmetic)]
    for _ in range(ITERATIONS):
        atoms = _lloyd(sample, atoms, arithmetic)
    return atoms


def unit(vectors: Floats, otherwise: Floats) -> Floats:
    """[N, D] scaled to unit norm; rows of ``otherwise`` in place of those without a direction."""
    norms = np.sqrt((vectors * vectors).sum(1, keepdims=True))
    return np.where(norms > 1e-6, vectors / np.maximum(norms, 1e-6), otherwise)


def _plus_plus(rows: Floats, n_atoms: int, random: torch.Generator, arithmetic: Arithmetic) -> list[int]:
    chosen = [int(torch.randint(len(rows), (1,), generator=random))]
    distance = _distances(rows, chosen, arithmetic)[:, 0]
    while len(chosen) < n_atoms:
        cumulative = distance.astype(np.float64).cumsum()
        draws = torch.rand(TRIALS, generator=random, dtype=torch.float64).numpy()
        if cumulative[-1] > 0:
            picks = np.searchsorted(cumulative, draws * cumulative[-1], side="right")
            picks = np.minimum(picks, len(rows) - 1)
        else:  # every row is already an atom
            picks = (draws * len(rows)).astype(np.int64)
        reduced = np.minimum(distance[:, None], _distances(rows, picks.tolist(), arithmetic))
        winner = int(reduced.sum(0, dtype=np.float64).argmin())
        chosen.append(int(picks[winner]))
        distance = np.ascontiguousarray(reduced[:, winner])
    return chosen


def _distances(rows: Floats, picks: list[int], arithmetic: Arithmetic) -> Floats:
    """[R, P]: 1 - cosine to some of the rows, exactly 0 for equal rows."""
    distance = 1 - arithmetic.row_products(rows, rows[picks])
    return np.where(distance > _SAME, distance, np.float32(0))


def _lloyd(rows: Floats, atoms: Floats, arithmetic: Arithmetic) -> Floats:
    similarities = arithmetic.row_products(rows, atoms)
    nearest = similarities.argmax(1)
    best = similarities[np.arange(len(rows)), nearest]
    ones = np.ones(len(rows), np.float32)
    members = RowCodes(nearest.astype(np.int32)[:, None], ones[:, None], ones)
    _, sums = arithmetic.code_moments(rows, members, ones, len(atoms))
    atoms = unit(sums.astype(np.float32), atoms)
    empty = np.flatnonzero(np.bincount(nearest, minlength=len(atoms)) == 0)
    worst = np.argsort(best, kind="stable")[: len(empty)]
    # Rows that an atom already stands for need no second one.
    useful = best[worst] < 1 - _SAME
    atoms[empty[: len(worst)][useful]] = rows[worst[useful]]
    return atoms
