"""The exact solver: codes are solved for, so only the codebook is learned.

Given the codebook, coding one region is a small non-negative least-squares problem with at most K non-zeros, which
the coder (``exact_reference`` states it) solves almost always to the optimum. What is left is a problem in the atoms
C alone. With the least-squares weights w of a unit row f and their cosine c, the loss 1 - c has the gradient

    u (w w^T C - w f^T),  u = 1 / c    (w need not be differentiated: it is optimal)

so a set of rows is summed up by A = sum of u w w^T and B = sum of u w f^T. First Adam (Kingma and Ba 2015) walks along
(A C - B) / n of small batches; then A C = B is solved over all rows a few times, as in the method of optimal directions
(Engan, Aase and Husoy 1999). Atoms have unit norm throughout: norms that spread would distort the vote of the uplift,
which adds up weights.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from scoup.codes import SparseCodes
from scoup.coding.arithmetic import (
    Arithmetic,
    Doubles,
    Floats,
    RowCodes,
    arithmetic_at_hand,
    as_sparse_codes,
)
from scoup.coding.exact_start import starting_atoms, unit
from scoup.progress import Progress, no_progress

BETAS = (0.9, 0.99)
EPSILON = 1e-8
RESEED_EVERY = 25  # steps
RESEED_UNTIL = 0.7  # share of the steps
RARE = 2e-4  # atoms used by a smaller share of rows are placed anew
RIDGE = 1e-4  # pull to the present atoms, as a share of the mean diagonal of A
OVERSTEP = 0.9  # how much further than the least-squares atoms a pass goes; more than 1 diverges
FINAL_SWAPS = 2
_LEAST_COSINE = 0.1  # rows that are coded worse weigh no more than those coded so


@dataclass(frozen=True)
class ExactSettings:
    """What the solver may be told.

    Attributes:
        steps: Adam steps on the codebook.
        batch: rows of a step.
        learning_rate: of the first step; it falls to zero along a cosine.
        passes: closed-form passes over all rows afterwards, at most.
    """

    steps: int = 200
    batch: int = 500
    learning_rate: float = 1e-2
    passes: int = 5


BEST = ExactSettings()
FAST = ExactSettings(steps=100, passes=0)
PRESETS = {"fast": FAST, "best": BEST}


@dataclass(frozen=True, eq=False)
class ExactSolution:
    """What the solver learned.

    Attributes:
        atoms: [L, D] float32, unit norm.
        codes: of the rows.
        steps: Adam steps and passes run.
        losses: mean loss over all rows before the passes, after each pass that was kept, and at the end; it never
            rises.
    """

    atoms: Tensor  # [L, D]
    codes: SparseCodes
    steps: int
    losses: tuple[float, ...]


def solve_exact(
    rows: Tensor,  # [R, D]
    n_atoms: int,
    k: int,
    seed: int = 0,
    settings: ExactSettings = BEST,
    progress: Progress = no_progress,
) -> ExactSolution:
    """Learn unit atoms and K-sparse codes of unit rows (method.md, stage 1) by exact coding.

    The same seed gives the same bytes on the same kind of CPU; with the compiled core, whatever the number of
    threads. The work is done on the CPU. Beyond the rows it takes memory for the codes and for L x (L + D) numbers.

    Args:
        rows: [R, D] float32 unit vectors, R >= 1.
        n_atoms: L.
        k: most atoms a row may use; more than L counts as L.
        seed: of the start and of the batches.
        settings: see ``ExactSettings``; ``FAST`` takes about half the time of ``BEST``.
        progress: told after every step and pass, as stage "sparse coding".
    """
    learner = _Learner(rows.detach().cpu().float().contiguous().numpy(), n_atoms, min(k, n_atoms), seed)
    total = settings.steps + settings.passes + 1
    progress("sparse coding", 0, total)
    done = 0
    for done, _ in enumerate(itertools.chain(learner.steps(settings), learner.passes(settings)), 1):
        progress("sparse coding", done, total)
    codes = learner.final_codes()
    progress("sparse coding", total, total)
    atoms = torch.from_numpy(learner.atoms).to(rows.device)
    return ExactSolution(atoms, as_sparse_codes(codes, n_atoms, k, rows.device), done, tuple(learner.losses))


class _Learner:
    def __init__(self, rows: Floats, n_atoms: int, k: int, seed: int) -> None:
        self._rows = rows
        self._k = k
        self._random = torch.Generator().manual_seed(seed)
        self._arithmetic: Arithmetic = arithmetic_at_hand()
        self.atoms = starting_atoms(rows, n_atoms, self._random, self._arithmetic)
        self._codes: RowCodes | None = None
        self.losses: list[float] = []

    def steps(self, settings: ExactSettings) -> Iterator[None]:
        """Take Adam steps, yielding after each."""
        first, second = np.zeros_like(self.atoms), np.zeros_like(self.atoms)
        uses = np.zeros(len(self.atoms), np.int64)
        seen = 0
        batches = self._batches(min(settings.batch, len(self._rows)))
        for step in range(1, settings.steps + 1):
            rows = self._rows[next(batches)]
            codes = self._arithmetic.code_rows(rows, self.atoms, self._k, swap_passes=1)
            within, toward = self._moments(rows, codes)
            gradient = self._gradient(within, toward) / np.float32(len(rows))
            first += (gradient - first) * np.float32(1 - BETAS[0])
            second += (gradient * gradient - second) * np.float32(1 - BETAS[1])
            rate = settings.learning_rate * 0.5 * (1 + math.cos(math.pi * step / settings.steps))
            rate /= 1 - BETAS[0] ** step
            root = np.sqrt(second / np.float32(1 - BETAS[1] ** step)) + np.float32(EPSILON)
            self.atoms = unit(self.atoms - np.float32(rate) * first / root, self.atoms)

            uses += np.bincount(codes.support[codes.support >= 0], minlength=len(uses))
            seen += len(rows)
            if step % RESEED_EVERY == 0:
                if step < RESEED_UNTIL * settings.steps:
                    placed = self._reseed(np.flatnonzero(uses < RARE * seen), rows, codes.cosines)
                    first[placed] = second[placed] = 0
                uses[:] = seen = 0
            yield

    def passes(self, settings: ExactSettings) -> Iterator[None]:
        """Solve for the codebook over all rows again and again, keeping what lowers the loss; yields after each."""
        if settings.passes == 0:
            return
        codes = self._code(self.atoms, swap_passes=1)
        loss = _loss(codes)
        self.losses.append(loss)
        overstep = 0.0  # not in the first pass
        for _ in range(settings.passes):
            target = self._least_squares_atoms(codes)
            atoms = unit(target + np.float32(overstep) * (target - self.atoms), self.atoms)
            tried = self._code(atoms, swap_passes=1, warm=codes.support)
            better = _loss(tried) <= loss
            if better:
                self.atoms, codes, loss = atoms, tried, _loss(tried)
                self.losses.append(loss)
            yield
            if not better and overstep == 0:
                break
            overstep = OVERSTEP if better else 0.0
        self._codes = codes

    def final_codes(self) -> RowCodes:
        """Codes of all rows, going on from those of the last pass if there was one."""
        codes = self._code(self.atoms, FINAL_SWAPS, None if self._codes is None else self._codes.support)
        self.losses.append(_loss(codes))
        return codes

    def _batches(self, size: int) -> Iterator[np.ndarray]:
        """Row numbers [size] without end, every row once before any comes again, but for a last few."""
        while True:
            order = torch.randperm(len(self._rows), generator=self._random).numpy()
            for start in range(0, len(order) - size + 1, size):
                yield order[start : start + size]

    def _code(self, atoms: Floats, swap_passes: int, warm: np.ndarray | None = None) -> RowCodes:
        return self._arithmetic.code_rows(self._rows, atoms, self._k, swap_passes, warm)

    def _moments(self, rows: Floats, codes: RowCodes) -> tuple[Doubles, Doubles]:
        scale: Floats = np.reciprocal(np.maximum(codes.cosines, np.float32(_LEAST_COSINE)))
        return self._arithmetic.code_moments(rows, codes, scale, len(self.atoms))

    def _gradient(self, within: Doubles, toward: Doubles) -> Floats:
        columns = np.ascontiguousarray(self.atoms.T)
        return self._arithmetic.row_products(within.astype(np.float32), columns) - toward.astype(np.float32)

    def _least_squares_atoms(self, codes: RowCodes) -> Floats:
        within, toward = self._moments(self._rows, codes)
        # Also holds atoms that nobody uses where they are.
        ridge = max(RIDGE * float(within.diagonal().mean()), 1e-12)
        within[np.diag_indices_from(within)] += ridge
        return self._arithmetic.solve(within, toward + ridge * self.atoms).astype(np.float32)

    def _reseed(self, rare: np.ndarray, rows: Floats, cosines: Floats) -> np.ndarray:
        """Place rarely used atoms at the rows that are coded worst; which were placed."""
        worst = np.argsort(cosines, kind="stable")[: len(rare)]
        worst = worst[cosines[worst] < 1 - 1e-6]
        placed = rare[: len(worst)]
        self.atoms[placed] = rows[worst]
        return placed


def _loss(codes: RowCodes) -> float:
    return 1.0 - float(codes.cosines.mean(dtype=np.float64))
