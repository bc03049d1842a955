"""scoup eval baselines: methods compared on the scenes of one data set."""

from __future__ import annotations

from dataclasses import dataclass

from scoup.cli.console import Console
from scoup.cli.options import Flag
from scoup_lab.cli.evaluate.options import Names, StudyOptions


@dataclass(frozen=True, kw_only=True)
class Baselines(StudyOptions):
    """Compare the method with dense uplift, centre pixels (Occam's LGS), visible centre pixels (VALA), top contributors
    with product quantisation (Dr. Splat), LangSplat's autoencoder and, by name, codes learned through renderings
    (LangSplatV2), on the same regions and with the same queries.

    Accuracy, time, memory and storage of each; docs/evaluation.md says what each follows and where it departs.
    """

    methods: Names = ()
    """Methods to run; repeat it for several. Default: all but sparse-all, autoencoder-lerf and
    joint-codes; the last two take tens of minutes a scene."""
    seed: int = 0
    """Seed of all that is random."""
    epochs: int = 100
    """Epochs of the autoencoder; LangSplat's own is 100."""
    iterations: int = 10_000
    """Steps of joint-codes at each level; LangSplatV2's own is 10000."""
    selection: Flag = False
    """Also score by the 3D-selection protocol, in a table of its own."""

    def run(self, console: Console) -> None:
        """Run all and write the tables."""
        from dataclasses import replace

        from scoup_lab.baselines.autoencoder import LANGSPLAT
        from scoup_lab.baselines.joint_codes import LANGSPLATV2
        from scoup_lab.baselines.method import MethodSettings
        from scoup_lab.baselines.methods import COMPARED, find_method
        from scoup_lab.bench.environment import describe_environment
        from scoup_lab.evaluate.studies.comparison import compare, comparison_report

        methods = [find_method(name) for name in self.methods or COMPARED]
        settings = MethodSettings(
            self.seed,
            autoencoder=replace(LANGSPLAT, epochs=self.epochs),
            joint=replace(LANGSPLATV2, iterations=self.iterations),
        )
        scenes = self.open_study(console, "baselines")
        with console.progress() as progress:
            results = compare(scenes, methods, self.preset(), settings, self.selection, progress)
        described = {
            "rules": self.rules,
            "seed": self.seed,
            "epochs": self.epochs,
            "iterations": self.iterations,
            "environment": describe_environment(),
        }
        self.write(console, comparison_report(results, methods, described))
