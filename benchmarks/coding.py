"""Sparse coding: the exact solver beside the paper's Adam and LangSplat's autoencoder."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import torch
from tests.coding.plain_adam import plain_adam

from benchmarks.study import Record, Study, report
from scoup.base.counts import counted
from scoup.coding.adam import LEARNING_RATE, LOGIT_SCALE, AdamSettings, solve_adam
from scoup.coding.exact import EFFORTS, solve_exact
from scoup.coding.kmeans import spherical_kmeans
from scoup.coding.report import report_on
from scoup_lab.baselines.autoencoder import LANGSPLAT, fit_autoencoder
from scoup_lab.bench import Stopwatch, Task, Timing, markdown, time_tasks, torch_threads
from scoup_lab.bench.report import milliseconds
from scoup_lab.synthetic.random_scene import clip_like

PAPER_EPOCHS = 4000
GRAM, PLAIN, AUTOENCODER = "Adam in Gram space", "Adam, plain autograd", "autoencoder"
STEPS = 100  # of the autoencoder, timed together


@dataclass(frozen=True, kw_only=True)
class Coding(Study):
    """Time the exact solver, the paper's Adam (in Gram space and as plain autograd) and LangSplat's autoencoder.

    Rows are synthetic and like CLIP's: a common mean, objects with long-tailed frequencies, noise. At each number of
    regions everything is timed interleaved: whole fits of the exact solver, early epochs of both forms of Adam
    (supports change little there) and steps of the autoencoder. Then Adam is run to its end once, where there are few
    enough regions. Other whole fits are extrapolated from epochs and steps.
    """

    regions: tuple[int, ...] = (5000, 20_000, 60_000)
    """Numbers of regions, R."""
    repeats: int = 3
    """Interleaved repetitions; medians are printed."""
    dim: int = 512
    """D."""
    n_atoms: int = 64
    """L."""
    k: int = 4
    """K."""
    threads: int = 1
    """Threads."""
    adam_up_to: int = 5000
    """The most regions for which Adam is run to its end."""
    adam_epochs: int = PAPER_EPOCHS
    """Epochs of that fit."""
    seed: int = 0
    """Of everything."""

    def measure(self, known: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
        for count in self.regions:
            if str(count) not in known:
                yield str(count), self._size(count)

    def record(self, rows: dict[str, Any]) -> Record:
        return {"sizes": list(rows.values())}

    @staticmethod
    def table(record: Record) -> str:
        """Return what the others take, and how many times as long as the exact solver that is."""
        body = []
        for size in record["sizes"]:
            network, run = size[AUTOENCODER], size.get("adam")
            measured = {GRAM} if run and run["epochs"] == PAPER_EPOCHS else set()
            lines = [(name, of["median"], size["whole_adam_s"][name]) for name, of in size["epoch_s"].items()]
            named = f"{AUTOENCODER}, {counted(network['threads'], 'thread')}"
            for name, median, seconds in [
                *lines,
                (named, network["step_s"]["median"], network["all_epochs_s"]),
            ]:
                how = "measured" if name in measured else "extrapolated"
                times = (seconds / size["exact"][preset]["seconds"]["median"] for preset in ("fast", "best"))
                cells = [f"{size['regions']:,}", name, milliseconds(median), f"{seconds:.1f} ({how})"]
                body.append([*cells, *(f"{each:.0f}" for each in times)])
        return markdown(
            ["regions", "form", "median, ms", "whole fit, s", "times fast", "times best"], body, left=2
        )

    def _size(self, count: int) -> Record:
        """Return all figures for one number of regions."""
        rows = clip_like(count, self.dim, self.seed)
        units = {GRAM: min(max(800_000 // count, 8), 40), PLAIN: min(max(200_000 // count, 2), 4)}
        timings = self._timings(rows, units)
        epochs = {name: _spent(timings[name], number) for name, number in units.items()}
        steps = math.ceil(count / LANGSPLAT.batch)
        step = _spent(timings[AUTOENCODER], min(STEPS, steps))
        start = timings["kmeans"].median
        found: Record = {
            "regions": count,
            "exact": {name: {"seconds": _spent(timings[name], 1)} for name in EFFORTS},
            "kmeans_s": start,
            "epoch_s": epochs,
            "whole_adam_s": {name: start + PAPER_EPOCHS * each["median"] for name, each in epochs.items()},
            AUTOENCODER: {
                "threads": self.threads,
                "step_s": step,
                "all_epochs_s": LANGSPLAT.epochs * steps * step["median"],
            },
        }
        for name, settings in EFFORTS.items():
            solution = solve_exact(rows, self.n_atoms, self.k, self.seed, settings)
            found["exact"][name]["loss"] = report_on(rows, solution.atoms, solution.codes).loss
        if count <= self.adam_up_to:
            found["adam"] = self._whole_adam(rows)
            if self.adam_epochs == PAPER_EPOCHS:
                found["whole_adam_s"][GRAM] = found["adam"]["seconds"]
        return found

    def _timings(self, rows: torch.Tensor, epochs: Mapping[str, int]) -> dict[str, Timing]:
        atoms = spherical_kmeans(rows, self.n_atoms, self.seed)
        gram = AdamSettings(epochs=epochs[GRAM])
        runs = {
            name: lambda settings=settings: solve_exact(rows, self.n_atoms, self.k, self.seed, settings)
            for name, settings in EFFORTS.items()
        }
        runs |= {
            "kmeans": lambda: spherical_kmeans(rows, self.n_atoms, self.seed),
            GRAM: lambda: solve_adam(rows, self.n_atoms, self.k, 0, gram, initial_atoms=atoms),
            PLAIN: lambda: plain_adam(
                rows, atoms, LOGIT_SCALE * (rows @ atoms.T), self.k, epochs[PLAIN], LEARNING_RATE
            ),
            AUTOENCODER: lambda: fit_autoencoder(
                rows[: STEPS * LANGSPLAT.batch], replace(LANGSPLAT, epochs=1), self.seed
            ),
        }
        tasks = {name: Task(run, self.threads, self.repeats) for name, run in runs.items()}
        return time_tasks(tasks, progress=report)

    def _whole_adam(self, rows: torch.Tensor) -> Record:
        """Return seconds and loss of one whole fit by Adam in Gram space, k-means included."""
        settings, stopwatch = AdamSettings(epochs=self.adam_epochs), Stopwatch()
        with torch_threads(self.threads):
            solution = stopwatch("adam", solve_adam, rows, self.n_atoms, self.k, self.seed, settings)
        loss = report_on(rows, solution.atoms, solution.codes).loss
        return {"epochs": self.adam_epochs, "seconds": stopwatch.seconds["adam"][0], "loss": loss}


def _spent(timing: Timing, units: int) -> dict[str, float]:
    """Return median seconds of one of so many units."""
    return {"median": timing.median / units}
