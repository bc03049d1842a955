"""What ``benchmarks.coding`` runs: one fit, or a part of one, of every form of coding, timed and judged.

The exact solver in its parts, the paper's Adam in Gram space and as plain autograd, LangSplat's autoencoder, and the
best codes there are, by trying every support.
"""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from statistics import median
from typing import Any

import numpy as np
import torch
from tests.coding.plain_adam import plain_adam
from torch import Tensor

from scoup.base.progress import Progress, no_progress
from scoup.coding.adam import LEARNING_RATE, LOGIT_SCALE, AdamSettings, solve_adam
from scoup.coding.encode import encode
from scoup.coding.exact import EFFORTS, ExactSettings, solve_exact
from scoup.coding.kmeans import spherical_kmeans
from scoup.coding.report import decoded_cosines, report_on
from scoup.scene.codes import SparseCodes
from scoup_lab.baselines.autoencoder import LANGSPLAT, fit_autoencoder
from scoup_lab.bench.measure import torch_threads

Record = dict[str, Any]

EXACT = {
    "0 steps": ExactSettings(steps=0, passes=0),  # the start, coded
    "10 steps": ExactSettings(steps=10, passes=0),
    "25 steps": ExactSettings(steps=25, passes=0),
    "50 steps": ExactSettings(steps=50, passes=0),
    "fast": EFFORTS["fast"],
    "200 steps": ExactSettings(steps=200, passes=0),
    "best": EFFORTS["best"],
}
"""Schedules of the exact solver by rising cost, the presets among them."""
PAPER_EPOCHS = 4000
GRAM, PLAIN = "Adam in Gram space", "Adam, plain autograd"
PARTS = ("start", "steps", "passes", "final coding")
QUALITY = ("loss", "low_cosine", "rarest_cosine", "dead_atoms")
RAREST = 0.1  # share of the objects
OPTIMAL = 1e-6  # nearer to the best cosine than this counts as reaching it
MOST_SUPPORTS = 2_000_000  # more are not tried
AUTOENCODER_SAMPLE = 100  # steps timed in every repetition
_SUPPORTS_AT_A_TIME = 4096


class Moments:
    """Progress that notes the time of every call, to tell apart the parts of a fit."""

    def __init__(self) -> None:
        self.times: list[float] = []

    def __call__(self, stage: str, done: int, total: int) -> None:
        self.times.append(time.perf_counter())


def rarest_rows(objects: Tensor) -> Tensor:
    """[R] bool: the rows of that tenth of the objects [R] that has the fewest rows; at least of one object."""
    present, counts = objects.unique(return_counts=True)
    rarest = present[counts.argsort(stable=True)[: math.ceil(RAREST * len(present))]]
    return torch.isin(objects, rarest)


def judged(rows: Tensor, rare: Tensor, atoms: Tensor, codes: SparseCodes) -> Record:
    """Quality of codes of ``rows`` [R, D]; ``rare`` [R] from ``rarest_rows``."""
    report = report_on(rows, atoms, codes)
    chosen = rare.nonzero()[:, 0]
    of_rare = decoded_cosines(rows[chosen], atoms, codes.rows(chosen))
    return {
        "loss": report.loss,
        "low_cosine": report.low_cosine,
        "rarest_cosine": float(of_rare.double().mean()),
        "dead_atoms": report.dead_atoms,
    }


def exact_fit(rows: Tensor, rare: Tensor, n_atoms: int, k: int, seed: int, settings: ExactSettings) -> Record:
    """One fit of the exact solver: seconds, those of its parts, quality."""
    moments = Moments()
    started = time.perf_counter()
    solution = solve_exact(rows, n_atoms, k, seed, settings, moments)
    seconds = time.perf_counter() - started
    # The calls are: before the steps, after each step, after each pass that was run, and at the end.
    times = moments.times
    ends = [started, times[0], times[settings.steps], times[-2], times[-1]]
    parts = {
        name: after - before for name, (before, after) in zip(PARTS, itertools.pairwise(ends), strict=True)
    }
    return {"seconds": seconds, "parts": parts, **judged(rows, rare, solution.atoms, solution.codes)}


def first_atoms(rows: Tensor, n_atoms: int, seed: int) -> tuple[Tensor, float]:
    """The k-means codebook [L, D] that both forms of Adam start from, and its seconds."""
    started = time.perf_counter()
    atoms = spherical_kmeans(rows, n_atoms, seed)
    return atoms, time.perf_counter() - started


def gram_epoch(rows: Tensor, atoms: Tensor, k: int) -> float:
    """Seconds an early epoch of Adam in Gram space takes; supports change little there."""
    epochs = min(max(800_000 // len(rows), 8), 40)
    moments = Moments()
    solve_adam(rows, len(atoms), k, 0, AdamSettings(epochs=epochs), moments, initial_atoms=atoms)
    return (moments.times[-1] - moments.times[0]) / epochs


def plain_epoch(rows: Tensor, atoms: Tensor, k: int) -> float:
    """The same as plain autograd, from the same start."""
    epochs = min(max(200_000 // len(rows), 2), 4)
    logits = LOGIT_SCALE * (rows @ atoms.T)
    started = time.perf_counter()
    plain_adam(rows, atoms, logits, k, epochs, LEARNING_RATE)
    return (time.perf_counter() - started) / epochs


def whole_adam(
    rows: Tensor, rare: Tensor, n_atoms: int, k: int, seed: int, epochs: int, progress: Progress = no_progress
) -> Record:
    """One whole fit by Adam in Gram space, k-means included; and the loss of its atoms with exact codes."""
    started = time.perf_counter()
    solution = solve_adam(rows, n_atoms, k, seed, AdamSettings(epochs=epochs), progress)
    seconds = time.perf_counter() - started
    recoded = report_on(rows, solution.atoms, encode(rows, solution.atoms, k))
    return {
        "seed": seed,
        "epochs": solution.epochs,
        "seconds": seconds,
        "first_loss": solution.losses[0],
        "recoded_loss": recoded.loss,
        **judged(rows, rare, solution.atoms, solution.codes),
    }


def first_below(fits: dict[str, list[Record]], loss: float) -> tuple[str, float] | None:
    """The exact schedule of the least median time whose loss is below ``loss`` with every seed, and that time."""
    enough = [
        (median(fit["seconds"] for fit in runs), name)
        for name, runs in fits.items()
        if max(fit["loss"] for fit in runs) < loss
    ]
    if not enough:
        return None
    seconds, name = min(enough)
    return name, seconds


def autoencoder_steps(count: int) -> int:
    """Steps of an epoch of LangSplat's autoencoder on so many regions."""
    return math.ceil(count / LANGSPLAT.batch)


def autoencoder_step(rows: Tensor, seed: int, threads: int) -> float:
    """Seconds a step of the autoencoder takes, the median of some. It does not depend on the number of rows."""
    moments = Moments()
    some = rows[: AUTOENCODER_SAMPLE * LANGSPLAT.batch]
    with torch_threads(threads):
        fit_autoencoder(some, replace(LANGSPLAT, epochs=1), seed, moments)
    return median(after - before for before, after in itertools.pairwise(moments.times))


def autoencoder_fit(
    rows: Tensor, rare: Tensor, seed: int, most_steps: int, progress: Progress = no_progress
) -> Record:
    """One fit of the autoencoder, of fewer epochs than LangSplat's where those would be more than ``most_steps``."""
    epochs = min(max(most_steps // autoencoder_steps(len(rows)), 1), LANGSPLAT.epochs)
    fitted = fit_autoencoder(rows, replace(LANGSPLAT, epochs=epochs), seed, progress)
    chosen = rows[rare]
    decoded = fitted.decode(fitted.encode(chosen))
    return {
        "seed": seed,
        "epochs": epochs,
        "seconds": fitted.report.seconds,
        "loss": 1.0 - fitted.report.mean_cosine,
        "low_cosine": fitted.report.low_cosine,
        "rarest_cosine": float((decoded * chosen).sum(1).double().mean()),
    }


def is_whole(fitted: Record) -> bool:
    """Whether a fit of the autoencoder had all of LangSplat's epochs."""
    return fitted["epochs"] == LANGSPLAT.epochs


def brute_force_gap(rows: Tensor, atoms: Tensor, codes: SparseCodes) -> Record | None:
    """How far the codes of ``rows`` [n, D] are from the best there are; None where there are too many supports."""
    if math.comb(codes.n_atoms, min(codes.k, codes.n_atoms)) > MOST_SUPPORTS:
        return None
    similarities, gram = rows.double() @ atoms.double().T, atoms.double() @ atoms.double().T
    best = best_cosines(similarities, gram, codes.k)
    gaps = best - _cosines(codes.to_dense().double()[:, :, None], similarities[:, :, None], gram)[:, 0]
    return {
        "regions": len(rows),
        "mean": float(gaps.mean()),
        "greatest": float(gaps.max()),
        "optimal": float((gaps < OPTIMAL).double().mean()),
    }


def best_cosines(similarities: Tensor, gram: Tensor, k: int) -> Tensor:
    """[n] float64: the greatest cosine that at most k non-negative weights reach, by trying every support.

    Args:
        similarities: [n, L] float64, of unit rows to atoms.
        gram: [L, L] float64, of the atoms.
        k: most atoms of a code.
    """
    best = torch.zeros(len(similarities), dtype=torch.float64)
    for size in range(1, min(k, len(gram)) + 1):
        for supports in _supports(len(gram), size):
            within = gram[supports[:, :, None], supports[:, None, :]]
            toward = similarities.T[supports]
            # Atoms that depend on each other are never needed together: fewer of them do as well.
            inverse, failed = torch.linalg.inv_ex(within)
            weights = inverse @ toward
            # A best code has positive weights on its support, and is the solution without signs there.
            valid = (weights >= 0).all(1) & (failed == 0)[:, None]
            cosines = torch.where(valid, _cosines(weights, toward, within), 0.0)
            best = torch.maximum(best, cosines.amax(0))
    return best


def _cosines(weights: Tensor, toward: Tensor, within: Tensor) -> Tensor:
    """[B, n] cosines of codes: weights and similarities [B, size, n], Gram matrices [B, size, size] or one."""
    norms = (weights * (within @ weights)).sum(1).clamp(min=1e-30).sqrt()
    return (weights * toward).sum(1) / norms


def _supports(n_atoms: int, size: int) -> Iterator[Tensor]:
    """All supports of one size, some [C, size] at a time: all at once they take hundreds of megabytes."""
    numbers = itertools.chain.from_iterable(itertools.combinations(range(n_atoms), size))
    while len(block := np.fromiter(itertools.islice(numbers, _SUPPORTS_AT_A_TIME * size), np.int64)):
        yield torch.from_numpy(block.reshape(-1, size))


def least_and_median(seconds: Sequence[float]) -> Record:
    """For JSON: all of them, too."""
    return {"least": min(seconds), "median": median(seconds), "all": list(seconds)}
