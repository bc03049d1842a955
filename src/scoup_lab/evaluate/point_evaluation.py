"""Evaluation of a point-level data set: the field of each scene is built, its Gaussians are given classes, and points
are counted."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from torch import Tensor

from scoup.base.errors import InputError
from scoup.base.progress import Progress, no_progress
from scoup.io import load_gaussians, load_regions
from scoup.query.text_vectors import TextVectors
from scoup.scene.gaussians import Gaussians
from scoup.uplift.build_settings import BuildSettings
from scoup_lab.baselines.fitted import FittedField, FittedMethod
from scoup_lab.baselines.method import Method, MethodSettings
from scoup_lab.baselines.rasterised_scene import RasterisedScene
from scoup_lab.evaluate.point_scenes import PointDataSet, PointScene, PointTruth
from scoup_lab.evaluate.protocols.point_labels import ClassList, confusion_matrix, label_gaussians
from scoup_lab.evaluate.report import OURS
from scoup_lab.evaluate.scoring import build_field


@dataclass(frozen=True)
class PointSettings:
    """How a point-level data set is evaluated.

    Attributes:
        data_set: its protocol.
        class_lists: benchmarks to score by.
        build: of the fields.
        methods: further methods to score beside the fields, fitted to the same regions.
        level: name of the only level that answers; None lets each Gaussian be answered by its most relevant one.
        neighbours: how many Gaussians vote for a point, where points are not Gaussians.
        rebuild: build fields again that are there already.
        device: where tensors live.
    """

    data_set: PointDataSet
    class_lists: tuple[ClassList, ...]
    build: BuildSettings
    methods: tuple[Method, ...] = ()
    level: str | None = None
    neighbours: int = 1
    rebuild: bool = False
    device: str = "cpu"

    def __post_init__(self) -> None:
        if self.neighbours < 1:
            raise InputError(f"{self.neighbours} Gaussians are to vote for a point; at least 1 must")

    @property
    def texts(self) -> tuple[str, ...]:
        """What is queried, each once."""
        return tuple(dict.fromkeys(text for classes in self.class_lists for text in classes.texts))


Counts = dict[str, dict[str, Tensor]]
"""List of classes -> system -> confusion matrix [C, C + 1] of a scene."""


def evaluate_point_scene(
    scene: PointScene,
    vectors: TextVectors,
    out: Path,
    settings: PointSettings,
    progress: Progress = no_progress,
    say: Callable[[str], None] = lambda _: None,
) -> Counts:
    """Build what is missing, give classes, count.

    Args:
        scene: to be scored.
        vectors: of ``settings.texts``.
        out: folder of the fields.
        settings: see there.
        progress: called while building.
        say: is given a sentence where an interrupted build is continued.

    Raises:
        InputError: truth and Gaussians do not fit, or there is no such level.

    Returns:
        Nothing for lists of classes that none of the scene's points is of.
    """
    path = out / "fields" / f"{scene.name}.scoup"
    device, source = settings.device, vectors.source
    # Before the work of a build: what is wrong with the truth is known at once.
    truths = read_truths(scene, load_gaussians(scene.splat), settings)
    if not any(truth.counts for truth in truths.values()):
        say(f"{scene.name}: none of its points is of a class that is scored; left out")
        return {}
    field = build_field(scene, path, settings.build, source, settings.rebuild, device, progress, say)
    level = None if settings.level is None else field.level_index(settings.level)
    fitted: dict[str, FittedMethod] = {OURS: FittedField(field)}
    if settings.methods:
        regions = load_regions(scene.features, scene.cameras)
        gaussians = field.gaussians.to("cpu")
        rasterised = RasterisedScene(gaussians, scene.cameras, regions, field.info.raster_preset)
        method_settings = MethodSettings(settings.build.seed)
        fitted |= {method.name: method.fit(rasterised, method_settings) for method in settings.methods}
    return count_points(truths, field.gaussians, fitted, vectors, settings, level)


def read_truths(scene: PointScene, gaussians: Gaussians, settings: PointSettings) -> dict[str, PointTruth]:
    """The truth of a scene by the name of each list of classes.

    Raises:
        InputError: see ``PointScene.truth``.
    """
    return {classes.name: scene.truth(classes, gaussians) for classes in settings.class_lists}


def count_points(
    truths: Mapping[str, PointTruth],
    gaussians: Gaussians,
    fitted: Mapping[str, FittedMethod],
    vectors: TextVectors,
    settings: PointSettings,
    level: int | None = None,
) -> Counts:
    """The confusion matrices of what methods made of a scene, by the lists of classes that it has points of.

    Raises:
        InputError: there is no such level, or no Gaussian has a class.
    """
    scored = [classes for classes in settings.class_lists if truths[classes.name].counts]
    counts: Counts = {classes.name: {} for classes in scored}
    for classes in scored:
        truth, size = truths[classes.name], len(classes.classes)
        for name, method in fitted.items():
            given = classes.of_texts(label_gaussians(method, vectors, classes.texts, level))
            answers = truth.answers(gaussians, given, size, settings.neighbours)
            counts[classes.name][name] = confusion_matrix(truth.classes, answers, size)
    return counts
