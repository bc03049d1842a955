"""Cost of an epoch of the paper's solver: run in Gram space (ours) and as plain autograd, interleaved in one run.

    python -m benchmarks.coding [--regions 4000 20000] [--repeats 5] [--out result.json]

Rows are synthetic and CLIP-like: a common mean, objects with long-tailed frequencies, noise. Early epochs are timed
(supports change little there); the whole fit is timed once for the smaller size.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from statistics import median

import torch
import tyro
from tests.coding.plain_adam import plain_adam

from scoup.coding.adam import LOGIT_SCALE, AdamSettings, solve_adam
from scoup.coding.kmeans import spherical_kmeans


@dataclass(frozen=True)
class Arguments:
    regions: tuple[int, ...] = (4000, 20000)
    """Numbers of regions."""
    repeats: int = 5
    """Interleaved repetitions; medians are printed."""
    dim: int = 512
    """D."""
    n_atoms: int = 64
    """L."""
    k: int = 4
    """K."""
    seed: int = 0
    """Of the rows and of the start."""
    out: Path | None = None
    """Where to write the figures as JSON."""


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
    """Time both forms at each size and print a table."""
    results = []
    print(
        f"torch {torch.__version__}, {torch.get_num_threads()} threads, L={arguments.n_atoms}, K={arguments.k}"
    )
    print("| regions | Gram space, ms an epoch | plain autograd, ms an epoch | ratio |")
    print("|---|---|---|---|")
    for count in arguments.regions:
        rows = clip_like(count, arguments.dim, arguments.seed)
        atoms = spherical_kmeans(rows, arguments.n_atoms, arguments.seed)
        ours, plain = [], []
        for _ in range(arguments.repeats):
            ours.append(seconds_an_epoch(partial(fit, rows, atoms, arguments), 40))
            plain.append(seconds_an_epoch(partial(fit_plainly, rows, atoms, arguments), 4))
        ratio = median(plain) / median(ours)
        print(f"| {count} | {1e3 * median(ours):.2f} | {1e3 * median(plain):.1f} | {ratio:.1f} |")
        results.append({"regions": count, "gram": median(ours), "plain": median(plain), "ratio": ratio})
    smallest = min(arguments.regions)
    rows = clip_like(smallest, arguments.dim, arguments.seed)
    started = time.perf_counter()
    solution = solve_adam(rows, arguments.n_atoms, arguments.k, arguments.seed)
    seconds = time.perf_counter() - started
    print(
        f"the whole fit of {smallest} regions, {solution.epochs} epochs and k-means: {seconds:.1f} s, "
        f"loss {solution.losses[0]:.4f} -> {solution.losses[-1]:.4f}"
    )
    if arguments.out is not None:
        arguments.out.write_text(json.dumps({"epochs": results, "whole_fit_seconds": seconds}, indent=1))
    return results


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
    started = time.perf_counter()
    run(0)
    middle = time.perf_counter()
    run(epochs)
    return (time.perf_counter() - middle - (middle - started)) / epochs


if __name__ == "__main__":
    sys.exit(0 if main(tyro.cli(Arguments, description=__doc__)) else 1)
