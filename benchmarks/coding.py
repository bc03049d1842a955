"""Sparse coding: the exact solver against the paper's Adam (in Gram space, and as plain autograd) and LangSplat's
autoencoder, interleaved.

    python -m benchmarks.coding [--regions 5000 20000 60000 200000] [--repeats 5] [--threads 2]
        [--adam-epochs 4000] [--adam-up-to 20000] [--autoencoder-steps 8000] [--out FILE.json]

Rows are synthetic and CLIP-like: a common mean, objects with long-tailed frequencies, noise. Every repetition has a
seed of its own and times each schedule of the exact solver, early epochs of both forms of Adam (supports change
little there) and steps of the autoencoder, one after the other, forwards and backwards in turn. Then come one fit
by Adam to its end, where there are few enough regions; one of the autoencoder, of as many epochs as the allowed steps
make; and the best codes of some regions, by trying every support. Nothing uses a GPU.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

import torch
import tyro

from benchmarks.coding_forms import (
    EXACT,
    GRAM,
    PAPER_EPOCHS,
    PARTS,
    PLAIN,
    QUALITY,
    Record,
    autoencoder_fit,
    autoencoder_step,
    autoencoder_steps,
    brute_force_gap,
    exact_fit,
    first_atoms,
    first_below,
    gram_epoch,
    is_whole,
    least_and_median,
    plain_epoch,
    rarest_rows,
    whole_adam,
)
from benchmarks.coding_tables import print_tables
from benchmarks.raster import report
from scoup.base.backends import default_backend
from scoup.coding.exact import solve_exact
from scoup.io import check_output
from scoup_lab.baselines.autoencoder import LANGSPLAT
from scoup_lab.bench import describe_environment, write_json
from scoup_lab.bench.measure import torch_threads
from scoup_lab.synthetic.random_scene import clip_like_objects

AUTOENCODER = "autoencoder"
_WARM_ROWS = 500


@dataclass(frozen=True)
class Arguments:
    regions: tuple[int, ...] = (5000, 20_000, 60_000, 200_000)
    """Numbers of regions, R."""
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
    threads: int = 2
    """Threads."""
    adam_epochs: int = PAPER_EPOCHS
    """Epochs of the one fit by Adam that is run to its end; 0 leaves it out."""
    adam_up_to: int = 20_000
    """The most regions for which that fit is made."""
    plain: bool = True
    """Time the plain autograd form too."""
    autoencoder_steps: int = 8000
    """The most steps of the one fit of the autoencoder, at least an epoch; 0 leaves the autoencoder out."""
    gap_regions: int = 100
    """Regions whose best codes are found by trying every support; 0 leaves that out."""
    out: Path | None = None
    """Where to write the figures as JSON."""
    overwrite: bool = False
    """Replace OUT."""


def main(arguments: Arguments) -> Record:
    """Measure at each size, print the tables, give the record."""
    if arguments.out is not None:
        check_output(arguments.out, arguments.overwrite)
    environment = describe_environment()
    started = time.perf_counter()
    with torch_threads(arguments.threads):
        sizes = [measure(count, arguments) for count in arguments.regions]
    record: Record = {
        "what": "benchmarks.coding: solvers of stage 1 and the autoencoder, at the same rows",
        "machine": environment,
        "settings": {
            "dim": arguments.dim,
            "atoms": arguments.n_atoms,
            "k": arguments.k,
            "threads": arguments.threads,
            "repeats": arguments.repeats,
            "first_seed": arguments.seed,
            "adam_epochs": arguments.adam_epochs,
            "exact_with": default_backend(torch.device("cpu")),
            "schedules": {name: vars(settings) for name, settings in EXACT.items()},
        },
        "data": f"random_scene.clip_like, seed {arguments.seed}: unit, 300 objects, the i-th as often as 1/i",
        "extrapolated": extrapolated(sizes),
        "sizes": sizes,
        "seconds": time.perf_counter() - started,
    }
    print_tables(record)
    if arguments.out is not None:
        write_json(arguments.out, record, arguments.overwrite)
    return record


def measure(count: int, arguments: Arguments) -> Record:
    """All figures for one number of regions."""
    rows, objects = clip_like_objects(count, arguments.dim, arguments.seed)
    rare = rarest_rows(objects)
    n_atoms, k, seed = arguments.n_atoms, arguments.k, arguments.seed
    exact: dict[str, list[Record]] = {name: [] for name in EXACT}
    seconds: dict[str, list[float]] = {}
    for _, run in _jobs(rows[:_WARM_ROWS], rare[:_WARM_ROWS], seed, arguments):
        run()  # the first call may have to load things
    starts = []
    for repeat in range(arguments.repeats):
        jobs = list(_jobs(rows, rare, seed + repeat, arguments, starts))
        for done, (name, run) in enumerate(reversed(jobs) if repeat % 2 else jobs, 1):
            result = run()
            if name in exact:
                exact[name].append(result)
            else:
                seconds.setdefault(name, []).append(result)
            report(f"{count} regions, interleaved", repeat * len(jobs) + done, arguments.repeats * len(jobs))

    epochs = {name: least_and_median(each) for name, each in seconds.items() if name in (GRAM, PLAIN)}
    start = median(starts)
    measured: Record = {
        "regions": count,
        "objects": len(objects.unique()),
        "rarest_rows": int(rare.sum()),
        "exact": {name: _summary(fits) for name, fits in exact.items()},
        "kmeans_s": least_and_median(starts),
        "epoch_s": epochs,
        "whole_adam_s": {name: start + PAPER_EPOCHS * each["median"] for name, each in epochs.items()},
    }
    if arguments.adam_epochs and count <= arguments.adam_up_to:
        adam = whole_adam(rows, rare, n_atoms, k, seed, arguments.adam_epochs, report)
        below = first_below(exact, adam["loss"])
        adam["exact_below"] = None if below is None else {"schedule": below[0], "seconds": below[1]}
        measured["adam"] = adam
        if adam["epochs"] == PAPER_EPOCHS:
            measured["whole_adam_s"][GRAM] = adam["seconds"]
    if arguments.autoencoder_steps:
        measured["autoencoder"] = _autoencoder(rows, rare, seconds, arguments)
    if arguments.gap_regions:
        few = slice(0, arguments.gap_regions)
        solution = solve_exact(rows, n_atoms, k, seed)
        measured["gap"] = brute_force_gap(rows[few], solution.atoms, solution.codes.rows(few))
    return measured


def _jobs(
    rows: torch.Tensor,
    rare: torch.Tensor,
    seed: int,
    arguments: Arguments,
    starts: list[float] | None = None,
) -> Iterator[tuple[str, Callable[[], Any]]]:
    """What one repetition times; the seconds of the k-means that Adam starts from are added to ``starts``."""
    atoms, spent = first_atoms(rows, arguments.n_atoms, seed)
    if starts is not None:
        starts.append(spent)
    for name, settings in EXACT.items():
        yield name, partial(exact_fit, rows, rare, arguments.n_atoms, arguments.k, seed, settings)
    yield GRAM, partial(gram_epoch, rows, atoms, arguments.k)
    if arguments.plain:
        yield PLAIN, partial(plain_epoch, rows, atoms, arguments.k)
    if arguments.autoencoder_steps:
        # Its steps are so small that one thread may be faster than several.
        for threads in sorted({1, arguments.threads}):
            yield f"{AUTOENCODER} {threads}", partial(autoencoder_step, rows, seed, threads)


def _autoencoder(
    rows: torch.Tensor, rare: torch.Tensor, seconds: dict[str, list[float]], arguments: Arguments
) -> Record:
    """The long fit, with the number of threads whose steps were the faster; the time of all of LangSplat's epochs."""
    steps = {threads: seconds[f"{AUTOENCODER} {threads}"] for threads in sorted({1, arguments.threads})}
    fastest = min(steps, key=lambda threads: median(steps[threads]))
    with torch_threads(fastest):
        fitted = autoencoder_fit(rows, rare, arguments.seed, arguments.autoencoder_steps, report)
    whole = LANGSPLAT.epochs * autoencoder_steps(len(rows)) * median(steps[fastest])
    return {
        **fitted,
        "threads": fastest,
        "step_s": least_and_median(steps[fastest]),
        "step_s_by_threads": {str(threads): least_and_median(each) for threads, each in steps.items()},
        "all_epochs_s": fitted["seconds"] if is_whole(fitted) else whole,
    }


def _summary(fits: list[Record]) -> Record:
    return {
        "seconds": least_and_median([fit["seconds"] for fit in fits]),
        "parts_s": {part: least_and_median([fit["parts"][part] for fit in fits]) for part in PARTS},
        **{name: [fit[name] for fit in fits] for name in QUALITY},
    }


def extrapolated(sizes: list[Record]) -> list[str]:
    """Which figures were not measured but computed from others."""
    found = [
        f"whole fits by Adam of {PAPER_EPOCHS} epochs, but those marked as measured: the seconds of k-means and "
        f"{PAPER_EPOCHS} times an early epoch, medians"
    ]
    for size in sizes:
        fitted = size.get("autoencoder")
        if fitted and not is_whole(fitted):
            found.append(
                f"autoencoder, {size['regions']} regions: the time is {LANGSPLAT.epochs} epochs of the median step; "
                f"its cosines are those after {fitted['epochs']} epochs"
            )
    return found


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
