"""scoup eval ablations, curves, consistency: studies of the method on the scenes of one data set."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import tyro

from scoup.cli.console import Console
from scoup_lab.cli.evaluate.options import Names, StudyOptions


@dataclass(frozen=True, kw_only=True)
class Ablations(StudyOptions):
    """One thing at a time changed: dense uplift, no top-K, numbers of atoms and non-zeros, entropy filtering, solver
    and start, levels and how they are chosen, everyday words, fewer views, fewer pixels; at least three codebook seeds
    each. Table and plot.
    """

    groups: Names = ()
    """Groups of rows: vote, atoms, non-zeros, entropy, "solver and start", levels, phrases, views, pixels;
    repeat it for several. Default: all. The base is always run."""
    seeds: tuple[int, ...] = (0, 1, 2)
    """Seeds of the codebook; scores are means over them."""
    epochs: int = 4000
    """Epochs of Adam."""

    def run(self, console: Console) -> None:
        """Run all, write table and plot."""
        from scoup_lab.bench.environment import describe_environment
        from scoup_lab.evaluate.studies.ablation_rows import find_ablations
        from scoup_lab.evaluate.studies.ablations import ablation_report, run_ablations

        chosen = find_ablations(self.groups)
        scenes = self.open_study(console, "ablations")
        with console.progress() as progress:
            results = run_ablations(scenes, chosen, self.preset(), self.seeds, self.epochs, progress)
        described = {
            "rules": self.rules,
            "seeds": list(self.seeds),
            "epochs": self.epochs,
            "environment": describe_environment(),
        }
        self.write(console, ablation_report(results, scenes[0].labelled.data_set.protocol, described))


@dataclass(frozen=True, kw_only=True)
class Curves(StudyOptions):
    """Accuracy against faults put in on purpose: displaced and missing masks, noisy and wrong embeddings, fewer
    views. A table and a plot for each."""

    faults: Names = ()
    """What to put in: masks, missing, noise, wrong, views; repeat it for several. Default: all."""
    methods: Names = ()
    """Methods as in `scoup eval baselines`; repeat it for several. Default: as there, without those that
    take minutes (paper, autoencoder)."""
    seed: int = 0
    """Seed of the methods."""
    draw: int = 0
    """Seed of the faults."""
    epochs: int = 100
    """Epochs of the autoencoder, if it is among the methods."""

    def run(self, console: Console) -> None:
        """Run all, write tables and plots."""
        from dataclasses import replace

        from scoup_lab.baselines.autoencoder import LANGSPLAT
        from scoup_lab.baselines.method import MethodSettings
        from scoup_lab.baselines.methods import COMPARED, SLOW, find_method
        from scoup_lab.bench.environment import describe_environment
        from scoup_lab.evaluate.studies.curves import FAULT_SCALES, curve_report, find_fault, run_curves

        faults = [find_fault(name) for name in self.faults or FAULT_SCALES]
        names = self.methods or tuple(name for name in COMPARED if name not in SLOW)
        methods = [find_method(name) for name in names]
        settings = MethodSettings(self.seed, autoencoder=replace(LANGSPLAT, epochs=self.epochs))
        scenes = self.open_study(console, "curves")
        with console.progress() as progress:
            points = run_curves(scenes, methods, faults, self.preset(), settings, self.draw, progress)
        described = {"seed": self.seed, "draw": self.draw, "environment": describe_environment()}
        protocol = scenes[0].labelled.data_set.protocol
        self.write(console, curve_report(points, faults, protocol, described))


@dataclass(frozen=True, kw_only=True)
class Consistency(StudyOptions):
    """Multi-view consistency: cosine between matched observations of raw embeddings, of what LangSplat's autoencoder
    makes of them, and of decoded sparse codes.

    Matched by COLMAP's tracks where sparse/0 keeps them, otherwise by Gaussians that dominate the pixel under their
    centre.
    """

    preset_name: Annotated[Literal["default", "paper"], tyro.conf.arg(name="preset")] = "default"
    """How the sparse codes are learned: see scoup build."""
    seed: int = 0
    """Seed of codebook, network, and the pairs drawn."""
    epochs: int = 100
    """Epochs of the autoencoder."""

    def run(self, console: Console) -> None:
        """Match, compare, write."""
        from dataclasses import replace

        from scoup.uplift.build_settings import build_settings
        from scoup_lab.baselines.autoencoder import LANGSPLAT
        from scoup_lab.bench.environment import describe_environment
        from scoup_lab.evaluate.studies.consistency import consistency_report, run_consistency

        settings = build_settings(self.preset_name, seed=self.seed)
        autoencoder = replace(LANGSPLAT, epochs=self.epochs)
        scenes = self.open_study(console, "consistency")
        with console.progress() as progress:
            results, sources = run_consistency(scenes, settings, autoencoder, self.seed, progress)
        described = {
            "preset": self.preset_name,
            "seed": self.seed,
            "epochs": self.epochs,
            "environment": describe_environment(),
        }
        self.write(console, consistency_report(results, sources, described))
