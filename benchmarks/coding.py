"""Sparse coding: the exact solver against the paper's Adam, in Gram space (ours) and as plain autograd, interleaved.

    python -m benchmarks.coding [--regions 5000 20000 60000] [--repeats 5] [--adam-epochs 4000] [--out result.json]

Rows are synthetic and CLIP-like: a common mean, objects with long-tailed frequencies, noise. Every repetition has a
seed of its own and times one fit of the exact solver with each preset, then early epochs of both forms of Adam
(supports change little there). What 4000 epochs would take is extrapolated; the losses of Adam are of one real fit.
"""

from __future__ import annotations

import json
import os
import platform
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from statistics import mean, median

import torch
import tyro
from tests.coding.plain_adam import plain_adam

from scoup.coding.adam import LOGIT_SCALE, AdamSettings, solve_adam
from scoup.coding.arithmetic import arithmetic_at_hand
from scoup.coding.encode import encode
from scoup.coding.exact import PRESETS, solve_exact
from scoup.coding.kmeans import spherical_kmeans
from scoup.coding.report import CodingReport, report_on

PAPER_EPOCHS = 4000


@dataclass(frozen=True)
class Arguments:
    regions: tuple[int, ...] = (5000, 20000)
    """Numbers of regions."""
    repeats: int = 5
    """Interleaved repetitions, one seed each."""
    dim: int = 512
    """D."""
    n_atoms: int = 64
    """L."""
    k: int = 4
    """K."""
    seed: int = 0
    """Of the rows, and of the first repetition."""
    adam_epochs: int = 200
    """Epochs of the one fit by Adam at each size that is run to its end; the paper has 4000, 0 leaves it out."""
    plain: bool = True
    """Time the plain autograd form too."""
    out: Path | None = None
    """Where to write the figures as JSON."""


@dataclass
class Timed:
    """Figures of one way to fit, over the repetitions."""

    seconds: list[float] = field(default_factory=list)
    reports: list[CodingReport] = field(default_factory=list)

    def losses(self) -> list[float]:
        return [report.loss for report in self.reports]

    def row(self, name: str) -> str:
        losses = self.losses()
        return (
            f"| {name} | {min(self.seconds):.3f} | {median(self.seconds):.3f} | {mean(losses):.4f} "
            f"({min(losses):.4f} - {max(losses):.4f}) | {mean(r.low_cosine for r in self.reports):.3f} "
            f"| {mean(r.dead_atoms for r in self.reports):.1%} |"
        )


def clip_like(count: int, dim: int, seed: int) -> torch.Tensor:
    """[count, dim] unit rows: cosine about 0.5 between objects and 0.85 within one."""
    generator = torch.Generator().manual_seed(seed)
    common = torch.randn(dim, generator=generator)
    objects = torch.nn.functional.normalize(torch.randn(300, dim, generator=generator), dim=1) * dim**0.5
    frequency = 1.0 / torch.arange(1, 301)
    which = torch.multinomial(frequency, count, replacement=True, generator=generator)
    rows = common + 0.85 * objects[which] + 0.5 * torch.randn(count, dim, generator=generator)
    return torch.nn.functional.normalize(rows, dim=1)


def main(arguments: Arguments) -> list[dict]:
    """Time all forms at each size and print tables."""
    coder = type(arithmetic_at_hand()).__name__
    print(
        f"{platform.machine()}, {os.cpu_count()} cores, torch {torch.__version__}, {torch.get_num_threads()} threads, "
        f"exact solver with {coder}, D={arguments.dim}, L={arguments.n_atoms}, K={arguments.k}"
    )
    results = [measure(count, arguments) for count in arguments.regions]
    if arguments.out is not None:
        arguments.out.write_text(json.dumps(results, indent=1))
    return results


def measure(count: int, arguments: Arguments) -> dict:
    """All figures for one number of regions."""
    rows = clip_like(count, arguments.dim, arguments.seed)
    fits = {name: Timed() for name in PRESETS}
    ours, plain = [], []
    for repeat in range(arguments.repeats):
        seed = arguments.seed + repeat
        for name, preset in PRESETS.items():
            started = time.perf_counter()
            solution = solve_exact(rows, arguments.n_atoms, arguments.k, seed, preset)
            fits[name].seconds.append(time.perf_counter() - started)
            fits[name].reports.append(report_on(rows, solution.atoms, solution.codes))
        atoms = spherical_kmeans(rows, arguments.n_atoms, seed)
        ours.append(seconds_an_epoch(partial(fit, rows, atoms, arguments), 40))
        if arguments.plain:
            plain.append(seconds_an_epoch(partial(fit_plainly, rows, atoms, arguments), 4))
    print(f"\n{count} regions, {arguments.repeats} seeds from {arguments.seed}")
    print("| exact solver | s, least | s, median | loss, mean (range) | 5th percentile cosine | dead atoms |")
    print("|---|---|---|---|---|---|")
    for name, timed in fits.items():
        print(timed.row(name))
    print(
        f"| Adam | ms an epoch, least | median | s for {PAPER_EPOCHS} epochs (extrapolated) | times exact, best |"
    )
    print("|---|---|---|---|---|")
    best = median(fits["best"].seconds)
    for name, seconds in (("Gram space", ours), ("plain autograd", plain)):
        if seconds:
            middle = median(seconds)
            whole = PAPER_EPOCHS * middle
            print(
                f"| {name} | {1e3 * min(seconds):.2f} | {1e3 * middle:.2f} | {whole:.1f} | {whole / best:.0f} |"
            )
    result = {
        "regions": count,
        "exact": {name: {"seconds": t.seconds, "losses": t.losses()} for name, t in fits.items()},
        "adam_seconds_an_epoch": {"gram": ours, "plain": plain},
    }
    if arguments.adam_epochs:
        result["adam_fit"] = adam_fit(rows, arguments)
    return result


def adam_fit(rows: torch.Tensor, arguments: Arguments) -> dict:
    """One whole fit by Adam in Gram space: its cost, its loss, and that of its atoms with exact codes."""
    started = time.perf_counter()
    settings = AdamSettings(epochs=arguments.adam_epochs)
    solution = solve_adam(rows, arguments.n_atoms, arguments.k, arguments.seed, settings)
    seconds = time.perf_counter() - started
    report = report_on(rows, solution.atoms, solution.codes)
    recoded = report_on(rows, solution.atoms, encode(rows, solution.atoms, arguments.k))
    print(
        f"Adam, {solution.epochs} epochs and k-means (seed {arguments.seed}): {seconds:.1f} s, loss "
        f"{solution.losses[0]:.4f} -> {report.loss:.4f}, 5th percentile {report.low_cosine:.3f}; "
        f"its atoms with exact codes: {recoded.loss:.4f}"
    )
    return {"seconds": seconds, "epochs": solution.epochs, "loss": report.loss, "recoded": recoded.loss}


def fit(rows: torch.Tensor, atoms: torch.Tensor, arguments: Arguments, epochs: int) -> None:
    """Our form, from given atoms."""
    solve_adam(
        rows, arguments.n_atoms, arguments.k, settings=AdamSettings(epochs=epochs), initial_atoms=atoms
    )


def fit_plainly(rows: torch.Tensor, atoms: torch.Tensor, arguments: Arguments, epochs: int) -> None:
    """The plain form, from the same start."""
    logits = LOGIT_SCALE * (rows @ torch.nn.functional.normalize(atoms, dim=1).T)
    plain_adam(rows, atoms, logits, arguments.k, epochs, 7e-4)


def seconds_an_epoch(run: Callable[[int], None], epochs: int) -> float:
    """Seconds an epoch takes, the cost of starting and finishing taken off."""
    run(0)  # the first call may have to load things
    started = time.perf_counter()
    run(0)
    middle = time.perf_counter()
    run(epochs)
    return (time.perf_counter() - middle - (middle - started)) / epochs


if __name__ == "__main__":
    sys.exit(0 if main(tyro.cli(Arguments, description=__doc__)) else 1)
