"""The exact solver: codes are solved for, so only the codebook is learned.

Given the codebook, coding one region is a small non-negative least-squares problem with at most K non-zeros, which
the coder (``reference.code`` states it) solves almost always to the optimum. What is left is a problem in the atoms
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

from scoup.base import Progress, no_progress
from scoup.coding.arithmetic import ordered_sum, take_rows, unit
from scoup.coding.backends import CodingBackend, RowCodes, as_sparse_codes, coding_backend
from scoup.coding.codebook import Solution
from scoup.coding.kmeans import spherical_kmeans

BETAS = (0.9, 0.99)
EPSILON = 1e-8
START_ITERATIONS = 2  # of k-means
RESEED_EVERY = 25  # steps
RESEED_UNTIL = 0.7  # share of the steps
RARE = 2e-4  # atoms used by a smaller share of rows are reseeded
RIDGE = 1e-4  # pull to the present atoms, as a share of the mean diagonal of A
OVERSTEP = 0.9  # how much further than the least-squares atoms a pass goes; more than 1 diverges
FINAL_SWAPS = 2
_LEAST_COSINE = 0.1  # rows that are coded worse weigh no more than those coded so


@dataclass(frozen=True)
class ExactSettings:
    """Settings of the solver."""

    steps: int = 200  # of Adam on the codebook
    batch: int = 500  # rows of a step
    learning_rate: float = 1e-2  # of the first step; it falls to zero along a cosine
    passes: int = 5  # closed-form, over all rows afterwards, at most


BEST = ExactSettings()
FAST = ExactSettings(steps=100, passes=0)
EFFORTS = {"fast": FAST, "best": BEST}


def solve_exact(
    rows: Tensor,  # [R, D]
    n_atoms: int,
    k: int,
    seed: int = 0,
    settings: ExactSettings = BEST,
    progress: Progress = no_progress,
    backend: str | None = None,
) -> Solution:
    """Learn unit atoms and K-sparse codes of unit rows (method.md, stage 1) by exact coding.

    The work is done on the CPU, wherever the rows are. The same seed gives the same bytes; with the compiled core,
    whatever the number of threads. Beyond the rows it takes memory for the codes and for L x (L + D) numbers.

    ``k`` above L counts as L. ``FAST`` takes about half the time of ``BEST``. ``progress`` is called after every step
    and pass, as stage "sparse coding".
    """
    ours = rows.detach().cpu().float().contiguous()
    learner = Learner(ours, n_atoms, min(k, n_atoms), seed, coding_backend(backend))
    total = settings.steps + settings.passes + 1
    progress("sparse coding", 0, total)
    done = 0
    for done, _ in enumerate(itertools.chain(learner.steps(settings), learner.passes(settings)), 1):
        progress("sparse coding", done, total)
    codes = as_sparse_codes(learner.final_codes(), n_atoms, k, rows.device)
    progress("sparse coding", total, total)
    return Solution(learner.atoms.to(rows.device), codes, done, tuple(learner.losses))


class Learner:
    """The codebook while it is learned from unit rows; ``losses`` as in ``Solution``."""

    def __init__(self, rows: Tensor, n_atoms: int, k: int, seed: int, backend: CodingBackend) -> None:
        self.rows = rows
        self._k = k
        self._random = torch.Generator().manual_seed(seed)
        self._backend = backend
        self.atoms = spherical_kmeans(rows, n_atoms, self._random, backend, START_ITERATIONS)
        self._codes: RowCodes | None = None
        self.losses: list[float] = []

    def steps(self, settings: ExactSettings) -> Iterator[None]:
        """Take Adam steps, yielding after each."""
        first, second = np.zeros((2, *self.atoms.shape), np.float32)
        supports: list[Tensor] = []  # since the last reseeding
        batches = self._batches(min(settings.batch, len(self.rows)))
        for step in range(1, settings.steps + 1):
            rows = take_rows(self.rows, next(batches))
            codes = self._backend.code_rows(rows, self.atoms, self._k, swap_passes=1)
            gradient = self.gradient(rows, codes).numpy()
            first += (gradient - first) * (1 - BETAS[0])
            second += (gradient * gradient - second) * (1 - BETAS[1])
            rate = settings.learning_rate * 0.5 * (1 + math.cos(math.pi * step / settings.steps))
            rate /= 1 - BETAS[0] ** step
            root = np.sqrt(second / (1 - BETAS[1] ** step))
            moved = self.atoms.numpy() - rate * first / (root + EPSILON)
            self.atoms = unit(torch.from_numpy(moved), self.atoms)

            if step < RESEED_UNTIL * settings.steps:
                supports.append(codes.support)
                if step % RESEED_EVERY == 0:
                    placed = self.reseed(self._rare(torch.cat(supports)), rows, codes.cosines)
                    first[placed.numpy()] = second[placed.numpy()] = 0
                    supports.clear()
            yield

    def passes(self, settings: ExactSettings) -> Iterator[None]:
        """Solve for the codebook over all rows repeatedly, keeping what lowers the loss; yield after each."""
        if settings.passes == 0:
            return
        codes = self.code(self.atoms, swap_passes=1)
        loss = _loss(codes)
        self.losses.append(loss)
        overstep = 0.0  # not in the first pass
        for _ in range(settings.passes):
            target = self._least_squares_atoms(codes)
            atoms = unit(target + overstep * (target - self.atoms), self.atoms)
            tried = self.code(atoms, swap_passes=1, warm=codes.support)
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
        """Return codes of all rows, starting from those of the last pass, if any."""
        codes = self.code(self.atoms, FINAL_SWAPS, None if self._codes is None else self._codes.support)
        self.losses.append(_loss(codes))
        return codes

    def _batches(self, size: int) -> Iterator[Tensor]:
        """Yield row numbers [size] without end, every row once before any comes again, but for a last few."""
        while True:
            order = torch.randperm(len(self.rows), generator=self._random)
            for start in range(0, len(order) - size + 1, size):
                yield order[start : start + size]

    def code(self, atoms: Tensor, swap_passes: int, warm: Tensor | None = None) -> RowCodes:
        """Return codes of all rows over ``atoms`` [L, D]."""
        return self._backend.code_rows(self.rows, atoms, self._k, swap_passes, warm)

    def _moments(self, rows: Tensor, codes: RowCodes) -> tuple[Tensor, Tensor]:
        scale = codes.cosines.clamp(min=_LEAST_COSINE).reciprocal_()
        return self._backend.code_moments(rows, codes, scale, len(self.atoms))

    def gradient(self, rows: Tensor, codes: RowCodes) -> Tensor:
        """Return [L, D] float32: of the mean loss of some rows [n, D] with these codes, by the atoms."""
        within, toward = self._moments(rows, codes)
        columns = torch.from_numpy(np.ascontiguousarray(self.atoms.numpy().T))
        products = self._backend.row_products(within.float(), columns).numpy()
        return torch.from_numpy((products - toward.numpy().astype("float32")) / len(rows))

    def _least_squares_atoms(self, codes: RowCodes) -> Tensor:
        within, toward = self._moments(self.rows, codes)
        # Also keeps unused atoms in place.
        diagonal = within.diagonal()
        ridge = max(RIDGE * float(ordered_sum(diagonal, 0) / len(diagonal)), 1e-12)
        diagonal += ridge
        return self._backend.solve(within, toward + ridge * self.atoms).float()

    def _rare(self, supports: Tensor) -> Tensor:
        """Return the numbers of the atoms that few of these codes [n, K] use."""
        uses = torch.bincount(supports[supports >= 0], minlength=len(self.atoms))
        return (uses < RARE * len(supports)).nonzero()[:, 0]

    def reseed(self, rare: Tensor, rows: Tensor, cosines: Tensor) -> Tensor:
        """Place rarely used atoms at the rows that are coded worst; return the placed ones."""
        worst = cosines.argsort(stable=True)[: len(rare)]
        worst = worst[cosines[worst] < 1 - 1e-6]
        placed = rare[: len(worst)]
        self.atoms[placed] = rows[worst]
        return placed


def _loss(codes: RowCodes) -> float:
    return 1.0 - float(ordered_sum(codes.cosines.double(), 0)) / len(codes.cosines)
