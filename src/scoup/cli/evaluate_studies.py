"""scoup eval ablations, curves, consistency: studies of the method on the scenes of one data set."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import tyro

from scoup.cli.console import Console
from scoup.cli.evaluate_data_sets import Names
from scoup.cli.evaluate_many import ManyOptions
from scoup.cli.options import common_last


@common_last
@dataclass(frozen=True, kw_only=True)
class Ablations(ManyOptions):
    """One thing at a time changed: dense uplift, no top-K, numbers of atoms and non-zeros, entropy filtering, solver
    and start, levels and how they are chosen, everyday words, fewer views, fewer pixels; at least three codebook seeds
    each. Table and plot.
    """

    groups: Annotated[Names, tyro.conf.arg(metavar="NAME", help_behavior_hint="")] = ()
    """Groups of rows: vote, atoms, non-zeros, entropy, "solver and start", levels, phrases, views, pixels;
    repeat it for several. Default: all. The base is always run."""
    seeds: tuple[int, ...] = (0, 1, 2)
    """Of the codebook; scores are means over them."""
    epochs: int = 4000
    """Of Adam."""

    def run(self, console: Console) -> None:
        """Run all and write the table."""
        from scoup.bench.environment import describe_environment
        from scoup.evaluate.studies.ablation_recipes import find_ablations
        from scoup.evaluate.studies.ablations import (
            ablation_plot,
            ablation_record,
            ablation_tables,
            run_ablations,
        )

        chosen = find_ablations(self.groups)
        self.check("ablations")
        scenes = self.prepared(console)
        with console.progress() as progress:
            results = run_ablations(scenes, chosen, self.preset(), self.seeds, self.epochs, progress)
        protocol = scenes[0].data_set.protocol
        record = {
            "protocol": protocol,
            "rules": self.rules,
            "seeds": list(self.seeds),
            "epochs": self.epochs,
            "environment": describe_environment(),
            "rows": ablation_record(results),
        }
        pictures = {"ablations.png": ablation_plot(results, protocol)}
        self.write(console, "ablations", ablation_tables(results, protocol), "Ablations", record, pictures)


@common_last
@dataclass(frozen=True, kw_only=True)
class Curves(ManyOptions):
    """Accuracy against faults put in on purpose: displaced and missing masks, noisy and wrong embeddings, fewer
    views. A table and a plot for each."""

    faults: Annotated[Names, tyro.conf.arg(metavar="NAME", help_behavior_hint="")] = ()
    """masks, missing, noise, wrong, views; repeat it for several. Default: all."""
    methods: Annotated[Names, tyro.conf.arg(metavar="NAME", help_behavior_hint="")] = ()
    """Methods as in `scoup eval baselines`; repeat it for several. Default: all but the autoencoder, which is slow."""
    seed: int = 0
    """Of the methods."""
    draw: int = 0
    """Of the faults."""
    epochs: int = 100
    """Of the autoencoder, if it is among the methods."""

    def run(self, console: Console) -> None:
        """Run all, write tables and plots."""
        from dataclasses import replace

        from scoup.baselines.autoencoder import LANGSPLAT
        from scoup.baselines.methods import METHODS, MethodSettings, find_method
        from scoup.bench.environment import describe_environment
        from scoup.evaluate.studies.curves import (
            FAULTS,
            curve_plot,
            curve_record,
            curve_tables,
            find_fault,
            run_curves,
        )

        faults = [find_fault(name) for name in self.faults or FAULTS]
        names = self.methods or tuple(name for name in METHODS if name != "autoencoder")
        methods = [find_method(name) for name in names]
        self.check("curves")
        scenes = self.prepared(console)
        settings = MethodSettings(self.seed, autoencoder=replace(LANGSPLAT, epochs=self.epochs))
        with console.progress() as progress:
            points = run_curves(scenes, methods, faults, self.preset(), settings, self.draw, progress)
        protocol = scenes[0].data_set.protocol
        pictures = {f"curve_{fault.name}.png": curve_plot(points, fault, protocol) for fault in faults}
        record = {
            "protocol": protocol,
            "seed": self.seed,
            "draw": self.draw,
            "environment": describe_environment(),
            "points": curve_record(points),
        }
        self.write(
            console, "curves", curve_tables(points, faults, protocol), "Accuracy and faults", record, pictures
        )


@common_last
@dataclass(frozen=True, kw_only=True)
class Consistency(ManyOptions):
    """Multi-view consistency: cosine between matched observations of raw embeddings, of what LangSplat's autoencoder
    makes of them, and of decoded sparse codes.

    Matched by COLMAP's tracks where sparse/0 keeps them, otherwise by Gaussians that dominate the pixel under their
    centre.
    """

    preset_name: Annotated[Literal["default", "paper"], tyro.conf.arg(name="preset")] = "default"
    """Of the sparse codes."""
    seed: int = 0
    """Of codebook, network, and the pairs drawn."""
    epochs: int = 100
    """Of the autoencoder."""

    def run(self, console: Console) -> None:
        """Match, compare, write."""
        from dataclasses import replace

        from scoup.baselines.autoencoder import LANGSPLAT
        from scoup.evaluate.studies.consistency import (
            consistency,
            consistency_plot,
            consistency_record,
            consistency_table,
            dominant_gaussians,
            tracked_points,
        )
        from scoup.uplift.build_settings import build_settings

        self.check("consistency")
        settings = build_settings(self.preset_name, seed=self.seed)
        autoencoder = replace(LANGSPLAT, epochs=self.epochs)
        results, sources = [], {}
        scenes = self.prepared(console)
        with console.progress() as progress:
            for done, scene in enumerate(scenes):
                progress("consistency", done, len(scenes))
                matches = tracked_points(scene.scene.folder / "sparse" / "0", scene.cameras)
                if matches is None:
                    views = [camera for camera in scene.cameras if camera.name in scene.regions]
                    matches = dominant_gaussians(scene.gaussians, views, scene.raster_preset)
                sources[scene.name] = matches.source
                results += consistency(
                    scene.name, matches, scene.cameras, scene.regions, settings, autoencoder, self.seed
                )
            progress("consistency", len(scenes), len(scenes))
        record = {"epochs": self.epochs, **consistency_record(results, sources)}
        pictures = {"consistency.png": consistency_plot(results)}
        table = consistency_table(results, sources)
        self.write(console, "consistency", [table], "Multi-view consistency", record, pictures)
