"""scoup eval lerf-ovs, 3d-ovs, mipnerf360, scannet: one data set by its own protocol."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from scoup.cli import Console, Names, arg
from scoup_lab.cli.evaluate.options import DataSetVerb, Rules, kept_in, say_tables

if TYPE_CHECKING:
    from scoup_lab.evaluate.evaluation import Evaluation
    from scoup_lab.evaluate.scenes import SceneFiles


@dataclass(frozen=True, kw_only=True)
class FieldOptions:
    """How fields are built."""

    preset: Literal["default", "paper"] = "default"
    """How fields are built: default answers best, paper is the method as published (Adam, slow)."""
    n_atoms: int | None = None
    """Atoms in the codebook of each level (L). Default: the preset's."""


@dataclass(frozen=True, kw_only=True)
class Evaluated(DataSetVerb):
    """What all protocols have in common."""

    fields: Annotated[FieldOptions, arg(name="build")] = FieldOptions()

    protocol: ClassVar[str]
    """Its name."""

    def evaluation(self) -> Evaluation[Any, Any]:
        """Return what the options say."""
        raise NotImplementedError

    def opened(self, console: Console) -> Iterator[SceneFiles]:
        """Yield the scenes to score, one after another."""
        raise NotImplementedError

    def made(self) -> str:
        """Return what lies in OUT beside the tables."""
        return "fields"

    def shared(self) -> dict[str, Any]:
        """Return what evaluations of all units take."""
        from scoup.uplift import build_settings

        settings = build_settings(self.fields.preset, n_atoms=self.fields.n_atoms)
        return {"build": settings, "device": self.common.device}

    def run(self, console: Console) -> None:
        """Build what is missing, score, write."""
        from scoup_lab.bench.environment import describe_environment
        from scoup_lab.evaluate.report import refuse_existing

        evaluation = self.evaluation()
        out = self.out or Path(f"eval_{self.protocol}")
        for stem in evaluation.stems:
            refuse_existing(out, stem, self.common.overwrite)
        scenes = self.opened(console)
        console.kept = lambda: kept_in(out, "fields")
        results = {}
        with console.progress() as progress:
            for scene in scenes:
                source = self.text_source(scene)
                results[scene.name] = evaluation.scene(scene, source, out, progress, console.say)
        described = {"environment": describe_environment(), "root": str(self.root)}
        reports = evaluation.reports(results, described)
        for report in reports:
            report.write(out, self.common.overwrite)
            say_tables(console, report)
        console.say(f"{out}: tables (.md, .json, .tex), {self.made()}")
        console.result({"out": out, "reports": {report.stem: report.record for report in reports}})


@dataclass(frozen=True, kw_only=True)
class OfPixels(Evaluated):
    """What the protocols of labelled frames have in common."""

    rules: Rules = "scoup"
    """Rules that turn relevancy into masks and points; langsplat has some for LERF-OVS only."""
    selection: bool = False
    """Also score by the 3D-selection protocol, in tables of its own."""

    def evaluation(self) -> Evaluation[Any, Any]:
        from scoup_lab.evaluate.pixel_evaluation import PixelEvaluation
        from scoup_lab.evaluate.protocols import PIXELS

        return PixelEvaluation(
            protocol=PIXELS[self.protocol], rules=self.rules, selection=self.selection, **self.shared()
        )

    def made(self) -> str:
        return "fields, failures"

    def opened(self, console: Console) -> Iterator[SceneFiles]:
        from scoup_lab.evaluate.protocols import PIXELS

        # All before the first is built: what is wrong with a label is known at once.
        return iter(self.open_labelled(console, PIXELS[self.protocol]))


@dataclass(frozen=True, kw_only=True)
class LerfOvs(OfPixels):
    """Score LERF-OVS (figurines, ramen, teatime, waldo_kitchen): masks and points, with the rules of its protocol.

    Builds the fields that are missing, and writes tables by query, by scene and overall, with intervals, published
    figures marked as such, and the worst answers as pictures.
    """

    protocol: ClassVar[str] = "lerf-ovs"


@dataclass(frozen=True, kw_only=True)
class ThreeDOvs(OfPixels):
    """Score 3D-OVS (bed, bench, room, sofa, lawn): masks, with the rules of its protocol."""

    protocol: ClassVar[str] = "3d-ovs"


@dataclass(frozen=True, kw_only=True)
class MipNerf360(OfPixels):
    """Score Mip-NeRF 360 with the GAGS annotations (room, counter, garden, bonsai): masks, with the rules of its
    protocol."""

    protocol: ClassVar[str] = "mipnerf360"


def verb_of_protocol(name: str) -> type[OfPixels] | None:
    """Return the verb of a protocol that a package brings; None if there is no such protocol."""
    from scoup_lab.evaluate.protocols import PIXELS

    if name not in PIXELS:
        return None
    return type(OfPixels.__name__, (OfPixels,), {"protocol": name, "__doc__": PIXELS[name].help})


@dataclass(frozen=True, kw_only=True)
class ScanNet(Evaluated):
    """Score the Gaussians of ScanNet's scenes against the labels of their points, by OpenGaussian's 19, 15 and 10
    classes.

    ROOT contains SCENE/SCENE_vh_clean_2.labels.ply; the splat starts from these points, and its Gaussians keep their
    positions and order.
    """

    protocol: ClassVar[str] = "scannet"

    classes: Names = ()
    """Lists of classes to score by; repeat it for several. Default: 19, 15 and 10."""
    level: Literal["best", "s", "m", "l"] = "best"
    """The level that answers; best takes the one at which a Gaussian is most relevant to any class."""
    methods: Names = ()
    """Methods to score beside the field, as in scoup eval baselines; repeat it for several."""

    def evaluation(self) -> Evaluation[Any, Any]:
        from scoup_lab.baselines.methods import METHODS
        from scoup_lab.evaluate.point_evaluation import PointEvaluation
        from scoup_lab.evaluate.protocols import scannet

        return PointEvaluation(
            class_lists=tuple(scannet.find_class_list(name) for name in self.classes or scannet.CLASS_LISTS),
            methods=tuple(METHODS[name] for name in self.methods),
            level=None if self.level == "best" else self.level,
            **self.shared(),
        )

    def opened(self, console: Console) -> Iterator[SceneFiles]:
        from scoup_lab.evaluate.protocols import scannet

        names = scannet.find(self.root, self.data.scenes)
        return (scannet.open_scene(self.root, name, self.data.places()) for name in names)
