"""scoup eval baselines, ablations, consistency: studies on the scenes of one data set."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import tyro

from scoup.cli import Console, Names
from scoup_lab.cli.evaluate.options import DataSetVerb, Rules, kept_in, say_tables

if TYPE_CHECKING:
    from scoup_lab.evaluate.rules import MaskRule
    from scoup_lab.evaluate.studies.study import Study


@dataclass(frozen=True, kw_only=True)
class StudyVerb(DataSetVerb):
    """What commands that try several methods or rules on a data set have in common."""

    data_set: str = "lerf-ovs"
    """Layout of ROOT, and whose protocol scores: lerf-ovs, 3d-ovs, mipnerf360 or one of a package."""
    rules: Rules = "scoup"
    """Rules that turn relevancy into masks and points."""

    recorded: ClassVar[str]
    """Options that go into the record, between spaces."""

    def study(self, console: Console, out: Path) -> Study[Any]:
        """Return what the options say."""
        raise NotImplementedError

    def mask_rule(self) -> MaskRule:
        """Return the rule of the protocol."""
        from scoup_lab.evaluate.protocols import PIXELS

        return PIXELS[self.data_set].rule(self.rules)

    def run(self, console: Console) -> None:
        """Refuse outputs that are there, run all, write and show tables."""
        from scoup_lab.bench.environment import describe_environment
        from scoup_lab.evaluate.label_vectors import encode_labels
        from scoup_lab.evaluate.protocols import PIXELS
        from scoup_lab.evaluate.report import refuse_existing
        from scoup_lab.evaluate.studies.study_scene import open_study_scene

        out = self.out or Path(f"eval_{self.data_set}")
        study, protocol = self.study(console, out), PIXELS[self.data_set]
        refuse_existing(out, study.stem, self.common.overwrite)
        labelled = self.open_labelled(console, protocol)
        scenes = [open_study_scene(item, encode_labels(item, self.text_source(item))) for item in labelled]
        with console.progress() as progress:
            results = study.results(scenes, progress)
        described = {name.removesuffix("_name"): getattr(self, name) for name in self.recorded.split()}
        described["environment"] = describe_environment()
        report = study.report(results, protocol.title, described)
        written = report.write(out, self.common.overwrite)
        say_tables(console, report)
        console.say("written: " + ", ".join(str(path) for path in written))
        console.result({"out": out, **report.record})


@dataclass(frozen=True, kw_only=True)
class Baselines(StudyVerb):
    """Compare the method with dense uplift, centre pixels (Occam's LGS), visible centre pixels (VALA), top contributors
    with product quantisation (Dr. Splat), LangSplat's autoencoder and, by name, codes learned through renderings
    (LangSplatV2), on the same regions and with the same queries.

    Accuracy, time and storage of each; docs/evaluation.md says what each follows and where it departs. The same
    command resumes: results are kept in OUT/baselines.
    """

    methods: Names = ()
    """Methods to run; repeat it for several. Default: all but joint-codes, which takes tens of minutes a
    scene."""
    seed: int = 0
    """Random seed."""
    selection: bool = False
    """Also score by the 3D-selection protocol, in a table of its own."""

    recorded: ClassVar[str] = "rules seed"

    def study(self, console: Console, out: Path) -> Study[Any]:
        from scoup_lab.baselines.method import MethodSettings
        from scoup_lab.baselines.methods import COMPARED, METHODS
        from scoup_lab.evaluate.studies.comparison import Comparison

        methods = [METHODS[name] for name in self.methods or COMPARED]
        settings = MethodSettings(self.seed)
        folder = out / Comparison.stem
        console.kept = lambda: kept_in(folder, "results")
        return Comparison(methods, self.mask_rule(), folder, settings, self.selection, console.say)


@dataclass(frozen=True, kw_only=True)
class Ablations(StudyVerb):
    """Change one thing at a time: dense uplift, no top-K, numbers of atoms and non-zeros, entropy filtering, solver,
    the choice of the level, everyday words; at least three codebook seeds each.
    """

    groups: Names = ()
    """Groups of rows: vote, atoms, non-zeros, entropy, solver, levels, phrases; repeat it for several.
    Default: all. The base is always run."""
    seeds: tuple[int, ...] = (0, 1, 2)
    """Seeds of the codebook; scores are means over them."""

    recorded: ClassVar[str] = "rules seeds"

    def study(self, console: Console, out: Path) -> Study[Any]:
        from scoup_lab.evaluate.studies.ablation_rows import find_ablations
        from scoup_lab.evaluate.studies.ablations import Ablations as AblationStudy

        return AblationStudy(find_ablations(self.groups), self.mask_rule(), self.seeds)


@dataclass(frozen=True, kw_only=True)
class Consistency(StudyVerb):
    """Measure multi-view consistency: cosines between matched observations of raw, autoencoder-decoded and
    sparse-decoded embeddings.

    Matched by COLMAP's tracks if sparse/0 has them, otherwise by Gaussians that dominate the pixel under their centre.
    """

    preset_name: Annotated[Literal["default", "paper"], tyro.conf.arg(name="preset")] = "default"
    """How the sparse codes are learned: see scoup build."""
    seed: int = 0
    """Seed of codebook, network, and the pairs drawn."""

    recorded: ClassVar[str] = "preset_name seed"

    def study(self, console: Console, out: Path) -> Study[Any]:
        from scoup.uplift import build_settings
        from scoup_lab.baselines.autoencoder import LANGSPLAT
        from scoup_lab.evaluate.studies.consistency import Consistency as ConsistencyStudy

        settings = build_settings(self.preset_name, seed=self.seed)
        return ConsistencyStudy(settings, LANGSPLAT, self.seed)
