"""A labelled scene, rasterised once, on which methods and rules are tried."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from scoup import raster
from scoup.base import InputError, Progress, no_progress
from scoup.field import Field
from scoup.io import load_gaussians, load_regions, splat_source
from scoup.models import with_everyday
from scoup.query import TextVectors
from scoup.scene import Camera, Gaussians, rows_of
from scoup_lab.baselines.fitted import FittedField, FittedMethod
from scoup_lab.baselines.rasterised_scene import RasterisedScene
from scoup_lab.bench.measure import Stopwatch
from scoup_lab.data.labels import LabelledFrame
from scoup_lab.evaluate.protocols import selection
from scoup_lab.evaluate.protocols.pixels import LabelledScene
from scoup_lab.evaluate.rules import MaskRule
from scoup_lab.evaluate.scores import PairScore, SceneScore, scene_score


@dataclass(frozen=True)
class ScoringRule:
    """A rule from maps to scores."""

    mask_rule: MaskRule  # constants and choice of the level
    everyday: bool = False  # compare with everyday words too (``scoup.models.words``), which no protocol does
    coded: bool = False  # draw only Gaussians with a code (``relevancy_of_coded``); of sparse codes only

    @property
    def kind(self) -> tuple[bool, bool]:
        """Rules of one kind share maps."""
        return self.everyday, self.coded


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
        kind: tuple[bool, bool] = (False, False),
        clock: Stopwatch | None = None,
    ) -> Tensor:
        """Return the relevancy [S, Q, H, W] of a labelled frame, labels in its order, for a kind of rule.

        ``clock``: adds the seconds of the query, without those of the projection.
        """
        (everyday, coded), scene = kind, self.rasterised
        queries, size = self.vectors.of(frame.labels), self.labelled.map_size(frame, camera)
        canonical = self.vectors.canonical
        if everyday:
            canonical = with_everyday(canonical, self.vectors.everyday)
        if coded:
            if not isinstance(fitted, FittedField):
                raise InputError("only a method of sparse codes has Gaussians without a code to leave out")
            return relevancy_of_coded(fitted, scene.gaussians, camera, queries, canonical, size)
        projection = raster.project(scene.gaussians, camera, scene.raster_preset)
        return (clock or Stopwatch())("query", fitted.relevancy, projection, queries, canonical, size)

    def scores(
        self,
        fitted: FittedMethod,
        rules: Mapping[str, ScoringRule],
        progress: Progress = no_progress,
        clock: Stopwatch | None = None,
    ) -> dict[str, SceneScore]:
        """Return scores by the name of the rule. Maps are made once a frame for each kind of rule."""
        pairs: dict[str, list[PairScore]] = {name: [] for name in rules}
        kinds, frames = sorted({rule.kind for rule in rules.values()}), self.labelled.frames
        protocol, levels = self.labelled.protocol, self.rasterised.regions.levels
        progress("scoring frames", 0, len(frames))
        for done, (frame, camera) in enumerate(frames, start=1):
            maps = {kind: self.relevancy(fitted, frame, camera, kind, clock) for kind in kinds}
            for name, rule in rules.items():
                pairs[name] += protocol.score_frame(frame, maps[rule.kind], rule.mask_rule, levels)
            progress("scoring frames", done, len(frames))
        return {
            name: scene_score(self.name, rule.mask_rule.name, pairs[name], protocol.title)
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


def relevancy_of_coded(
    fitted: FittedField,
    gaussians: Gaussians,
    camera: Camera,
    queries: Tensor,
    canonical: Tensor,
    size: tuple[int, int] | None = None,
) -> Tensor:
    """Return ``fitted.relevancy`` [S, Q, H, W] where only Gaussians with a code are drawn: at each level the others are
    taken out of the scene, so that they hide nothing.

    Everywhere else a Gaussian without a code still blends (method.md, stage 2: none is dropped from the scene). Which
    of the two the paper means where it removes half of the Gaussians by entropy it does not say.
    """
    field, levels = fitted.field, []
    for level, chosen in enumerate(fitted.coded()):
        info = replace(field.info, levels=(field.levels[level],), n_gaussians=int(chosen.sum()))
        columns = slice(level, level + 1)
        codes = rows_of(field.code_indices[:, columns], chosen), field.code_weights[chosen, columns]
        alone = FittedField(Field(*codes, field.codebook[columns], info), fitted.all_kept)
        projection = raster.project(gaussians.select(chosen), camera, field.info.raster_preset)
        levels.append(alone.relevancy(projection, queries, canonical, size))
    return torch.cat(levels)
