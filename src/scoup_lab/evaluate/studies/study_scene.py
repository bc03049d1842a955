"""A labelled scene, rasterised once, on which methods and rules are tried."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from torch import Tensor

from scoup import raster
from scoup.base import Progress, no_progress
from scoup.io import load_gaussians, load_regions, splat_source
from scoup.models import with_everyday
from scoup.query import TextVectors
from scoup.scene import Camera
from scoup_lab.baselines.fitted import FittedMethod
from scoup_lab.baselines.rasterised_scene import RasterisedScene
from scoup_lab.bench.measure import Stopwatch
from scoup_lab.data.labels import LabelledFrame
from scoup_lab.evaluate.protocols import selection
from scoup_lab.evaluate.protocols.pixels import LabelledScene
from scoup_lab.evaluate.rules import MaskRule
from scoup_lab.evaluate.scores import PairScore, SceneScore


@dataclass(frozen=True)
class ScoringRule:
    """A rule from maps to scores."""

    mask_rule: MaskRule  # constants and choice of the level
    everyday: bool = False  # compare with everyday words too (``scoup.models.words``), which no protocol does


@dataclass(frozen=True, eq=False)
class StudyScene:
    """A labelled and rasterised scene, made by ``open_study_scene``."""

    labelled: LabelledScene  # the scene with its labels
    vectors: TextVectors  # of the labels
    rasterised: RasterisedScene  # the scene that methods are fitted to

    @property
    def name(self) -> str:
        return self.labelled.name

    def relevancy(
        self,
        fitted: FittedMethod,
        frame: LabelledFrame,
        camera: Camera,
        everyday: bool = False,
        clock: Stopwatch | None = None,
    ) -> Tensor:
        """Return the relevancy [S, Q, H, W] of a labelled frame, labels in its order, beside everyday words or not.

        ``clock``: adds the seconds of the query, without those of the projection.
        """
        scene = self.rasterised
        queries, size = self.vectors.of(frame.labels), self.labelled.map_size(frame, camera)
        canonical = self.vectors.canonical
        if everyday:
            canonical = with_everyday(canonical, self.vectors.everyday)
        projection = raster.project(scene.gaussians, camera, scene.raster_preset)
        return (clock or Stopwatch())("query", fitted.relevancy, projection, queries, canonical, size)

    def scores(
        self,
        fitted: FittedMethod,
        rules: Mapping[str, ScoringRule],
        progress: Progress = no_progress,
        clock: Stopwatch | None = None,
    ) -> dict[str, SceneScore]:
        """Return scores by the name of the rule; maps are made once a frame for all rules with the same words."""
        pairs: dict[str, list[PairScore]] = {name: [] for name in rules}
        kinds, frames = {rule.everyday for rule in rules.values()}, self.labelled.frames
        protocol, levels = self.labelled.protocol, self.rasterised.regions.levels
        progress("scoring frames", 0, len(frames))
        for done, (frame, camera) in enumerate(frames, start=1):
            maps = {kind: self.relevancy(fitted, frame, camera, kind, clock) for kind in kinds}
            for name, rule in rules.items():
                pairs[name] += protocol.score_frame(frame, maps[rule.everyday], rule.mask_rule, levels)
            progress("scoring frames", done, len(frames))
        return {
            name: SceneScore(self.name, rule.mask_rule.name, tuple(pairs[name]), protocol.title)
            for name, rule in rules.items()
        }

    def selection_score(self, fitted: FittedMethod) -> SceneScore:
        """Return the score by the 3D-selection protocol."""
        scene = self.rasterised
        return selection.score_method(
            self.labelled, self.vectors, fitted, scene.gaussians, scene.raster_preset
        )


def open_study_scene(labelled: LabelledScene, vectors: TextVectors) -> StudyScene:
    """Load the splat and open the regions; nothing is rasterised yet."""
    gaussians = load_gaussians(labelled.splat)
    regions = load_regions(labelled.features, labelled.cameras)
    preset = splat_source(labelled.splat).preset
    return StudyScene(labelled, vectors, RasterisedScene(gaussians, labelled.cameras, regions, preset))
