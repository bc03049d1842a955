"""scoup eval scannet, scenesplat: the classes of points."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Literal

from scoup.cli.build import CLIP_MODEL
from scoup.cli.console import Console
from scoup.cli.options import Flag, OptionalInteger, OptionalText, OptionGroups
from scoup_lab.cli.evaluate.options import DataSetOptions, Names

if TYPE_CHECKING:
    from scoup.query.text_vectors import TextVectors
    from scoup_lab.evaluate.point_evaluation import Counts, PointSettings
    from scoup_lab.evaluate.point_scenes import PointDataSet, PointScene


@dataclass(frozen=True, kw_only=True)
class PointScored(DataSetOptions):
    """Options of the point-level protocols."""

    option_groups: ClassVar[OptionGroups] = {
        "data set": "cameras",
        "scoring": "classes level neighbours methods",
        "build": "preset n_atoms k seed rebuild",
    }

    cameras: OptionalText = None
    """The cameras (folder or file), with {scene} for the scene's name. Default: those in each scene's folder."""
    classes: Names = ()
    """Lists of classes to score by; repeat it for several. Default: 19, 15 and 10 (scannet), scannet20 (scenesplat)."""
    level: Literal["best", "s", "m", "l"] = "best"
    """The level that answers; best takes the one at which a Gaussian is most relevant to any class."""
    neighbours: int = 1
    """How many nearest Gaussians vote for a point, where points are not Gaussians."""
    methods: Names = ()
    """Methods to score beside the field, as in scoup eval baselines; repeat it for several."""
    preset: Literal["default", "paper"] = "default"
    """How fields are built: default answers best, paper is the method as published (Adam, slow)."""
    n_atoms: OptionalInteger = None
    """Atoms in the codebook of each level (L). Default: the preset's."""
    k: OptionalInteger = None
    """Atoms in the code of a region (K). Default: the preset's."""
    seed: int = 0
    """Seed of the codebook's start, and of the methods."""
    rebuild: Flag = False
    """Build anew the fields that are there already."""

    data_set_name: ClassVar[str]
    default_classes: ClassVar[tuple[str, ...]]

    def settings(self) -> PointSettings:
        """What the options say."""
        from scoup.uplift.build_settings import build_settings
        from scoup_lab.baselines.methods import find_method
        from scoup_lab.evaluate.point_evaluation import PointSettings
        from scoup_lab.evaluate.point_scenes import find_class_list, find_point_data_set

        data_set = find_point_data_set(self.data_set_name)
        return PointSettings(
            data_set,
            tuple(find_class_list(data_set, name) for name in self.classes or self.default_classes),
            build_settings(self.preset, n_atoms=self.n_atoms, k=self.k, seed=self.seed),
            tuple(find_method(name) for name in self.methods),
            None if self.level == "best" else self.level,
            self.neighbours,
            self.rebuild,
            self.device,
        )

    def run(self, console: Console) -> None:
        """Build what is missing, give classes, count, write."""
        from scoup.io import check_output
        from scoup_lab.evaluate.point_evaluation import evaluate_point_scene

        settings = self.settings()
        out = self.out or Path(f"eval_{self.data_set_name}")
        for classes in settings.class_lists:
            for suffix in (".md", ".json", ".tex"):
                check_output(out / f"{self.data_set_name}_{classes.name}{suffix}", self.overwrite)
        names, vectors = self.scene_names(settings.data_set), _Vectors(self, settings)
        console.kept = lambda: f"fields so far are kept in {out}, run the same command again to continue"
        counts: dict[str, Counts] = {}
        with console.progress() as progress:
            for name in names:
                scene = self.open_scene(settings.data_set, name)
                counts[name] = evaluate_point_scene(
                    scene, vectors.of(scene), out, settings, progress, console.say
                )
        self.write(console, settings, counts, out)

    def scene_names(self, data_set: PointDataSet) -> list[str]:
        """Names of the scenes to score."""
        from scoup_lab.evaluate.point_scenes import find_point_scenes

        return find_point_scenes(data_set, self.root, self.scenes)

    def open_scene(self, data_set: PointDataSet, name: str) -> PointScene:
        """One of them."""
        from scoup_lab.evaluate.data_sets import Places
        from scoup_lab.evaluate.point_scenes import open_point_scene

        places = Places(self.gaussians, self.features, self.images, self.cameras)
        return open_point_scene(data_set, self.root, name, places, self.undistort)

    def write(self, console: Console, settings: PointSettings, counts: dict[str, Counts], out: Path) -> None:
        """Write and show the reports."""
        from scoup_lab.bench.environment import describe_environment
        from scoup_lab.evaluate.point_report import PointReport, overall_table, write_point_report

        described = {
            "environment": describe_environment(),
            "build": asdict(settings.build),
            "level": self.level,
            "neighbours": settings.neighbours,
            "root": str(self.root),
        }
        reports = [
            PointReport.of(settings.data_set, classes, counts, described) for classes in settings.class_lists
        ]
        records = {}
        for report in reports:
            stem = f"{self.data_set_name}_{report.classes.name}"
            records[stem] = write_point_report(report, out, stem, self.overwrite)
            console.say("\n" + overall_table(report).markdown())
        console.say(f"{out}: tables (.md, .json, .tex), fields")
        console.result({"out": out, "reports": records})


class _Vectors:
    """Vectors of what is queried, encoded once for all scenes of one table or model."""

    def __init__(self, options: PointScored, settings: PointSettings) -> None:
        self._options, self._settings = options, settings
        self._kept: dict[str, TextVectors] = {}

    def of(self, scene: PointScene) -> TextVectors:
        """Those for a scene."""
        from scoup_lab.evaluate.label_vectors import encode_words, text_source

        source = text_source(self._options.root, scene, self._options.text, CLIP_MODEL)
        if source not in self._kept:
            texts, device = self._settings.texts, self._settings.device
            self._kept[source] = encode_words(texts, source, f"a class of {scene.name}", device)
        return self._kept[source]


@dataclass(frozen=True, kw_only=True)
class ScanNet(PointScored):
    """Score the Gaussians of ScanNet's scenes against the labels of their points, by OpenGaussian's 19, 15 and 10
    classes.

    ROOT holds SCENE/SCENE_vh_clean_2.labels.ply; the splat starts from these points, and its Gaussians keep their
    positions and order.
    """

    data_set_name: ClassVar[str] = "scannet"
    default_classes: ClassVar[tuple[str, ...]] = ("19", "15", "10")


@dataclass(frozen=True, kw_only=True)
class SceneSplat(PointScored):
    """Score by SceneSplat-Bench: labelled points take the class of the nearest Gaussian; f-mIoU is over foreground
    classes.

    ROOT holds val/SCENE (or test/SCENE) with coord.npy and the classes of its points, for which --classes names the
    benchmark: scannet20, scannet200, scannetpp, matterport or holicity.
    """

    data_set_name: ClassVar[str] = "scenesplat"
    default_classes: ClassVar[tuple[str, ...]] = ("scannet20",)
