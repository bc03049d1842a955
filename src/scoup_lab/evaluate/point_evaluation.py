"""Evaluation of ScanNet's labelled points: the Gaussians of each field are given classes, and points are counted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from torch import Tensor

from scoup.base import Progress, no_progress
from scoup.io import load_gaussians, load_regions
from scoup.query import TextVectors
from scoup.scene import Gaussians
from scoup_lab.baselines.fitted import FittedField, FittedMethod
from scoup_lab.baselines.method import Method, MethodSettings
from scoup_lab.baselines.rasterised_scene import RasterisedScene
from scoup_lab.evaluate.evaluation import Evaluation, Say, say_nothing
from scoup_lab.evaluate.label_vectors import encode_words
from scoup_lab.evaluate.point_report import PointScores
from scoup_lab.evaluate.protocols import scannet
from scoup_lab.evaluate.protocols.points import NO_CLASS, ClassList, confusion_matrix, label_gaussians
from scoup_lab.evaluate.report import OURS, Report
from scoup_lab.evaluate.scenes import SceneFiles

Counts = dict[str, dict[str, Tensor]]
"""List of classes -> system -> confusion matrix [C, C + 1] of a scene."""


@dataclass(frozen=True, kw_only=True)
class PointEvaluation(Evaluation[SceneFiles, Counts]):
    """The evaluation of ScanNet's scenes."""

    class_lists: tuple[ClassList, ...]  # benchmarks to score by
    methods: tuple[Method, ...] = ()  # to score beside the fields, fitted to the same regions
    level: str | None = None  # the only level that answers; None: each Gaussian by its most relevant one
    encoded: dict[str, TextVectors] = field(default_factory=dict, init=False, repr=False)  # by source

    @property
    def stems(self) -> Sequence[str]:
        return [f"scannet_{classes.name}" for classes in self.class_lists]

    @property
    def texts(self) -> tuple[str, ...]:
        """Return the texts that are queried, each once."""
        return tuple(dict.fromkeys(text for classes in self.class_lists for text in classes.classes))

    def vectors(self, source: str, scene: str) -> TextVectors:
        """Return vectors of what is queried, encoded once for all scenes of one table or model."""
        if source not in self.encoded:
            self.encoded[source] = encode_words(self.texts, source, f"a class of {scene}", self.device)
        return self.encoded[source]

    def scene(
        self,
        scene: SceneFiles,
        source: str,
        out: Path,
        progress: Progress = no_progress,
        say: Say = say_nothing,
    ) -> Counts:
        """See ``Evaluation``; nothing for lists of classes that none of the scene's points is of."""
        vectors = self.vectors(source, scene.name)
        # Before the work of a build: what is wrong with the truth is known at once.
        truths = self.truths(scene, load_gaussians(scene.splat))
        if not any(_counts(truth) for truth in truths.values()):
            say(f"{scene.name}: none of its points is of a class that is scored; left out")
            return {}
        built = self.field(scene, out / "fields" / f"{scene.name}.scoup", source, progress)
        level = None if self.level is None else built.level_index(self.level)
        fitted: dict[str, FittedMethod] = {OURS: FittedField(built)}
        if self.methods:
            regions = load_regions(scene.features, scene.cameras)
            gaussians = built.gaussians.to("cpu")
            rasterised = RasterisedScene(gaussians, scene.cameras, regions, built.info.raster_preset)
            settings = MethodSettings(self.build.seed)
            fitted |= {method.name: method.fit(rasterised, settings) for method in self.methods}
        return self.count(truths, fitted, vectors, level)

    def truths(self, scene: SceneFiles, gaussians: Gaussians) -> dict[str, Tensor]:
        """Return [N] true class of each Gaussian of a scene, by the name of each list of classes."""
        return {
            classes.name: scannet.read_truth(scene.folder, classes, gaussians) for classes in self.class_lists
        }

    def count(
        self,
        truths: Mapping[str, Tensor],
        fitted: Mapping[str, FittedMethod],
        vectors: TextVectors,
        level: int | None = None,
    ) -> Counts:
        """Return the confusion matrices of methods on a scene, by the lists of classes that it has points of."""
        scored = [classes for classes in self.class_lists if _counts(truths[classes.name])]
        counts: Counts = {classes.name: {} for classes in scored}
        for classes in scored:
            truth, size = truths[classes.name], len(classes.classes)
            for name, method in fitted.items():
                given = label_gaussians(method, vectors, classes.classes, level).cpu()
                counts[classes.name][name] = confusion_matrix(truth, given, size)
        return counts

    def reports(self, results: dict[str, Counts], described: dict[str, Any]) -> list[Report]:
        """See ``Evaluation``: one by each list of classes."""
        settings = {**described, "build": self.build.to_dict(), "level": self.level or "best"}
        return [
            PointScores.of(classes, results, settings).report(stem)
            for classes, stem in zip(self.class_lists, self.stems, strict=True)
        ]


def _counts(truth: Tensor) -> bool:
    """Return whether any point has a class."""
    return bool((truth != NO_CLASS).any())
