"""A labelled scene, rasterised once, on which methods and rules are tried."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from scoup import raster
from scoup.base import InputError
from scoup.field import Field
from scoup.io import load_gaussians, load_regions, splat_source
from scoup.models import with_everyday
from scoup.query import TextVectors
from scoup.scene import Camera, Gaussians, rows_of
from scoup_lab.baselines.fitted import FittedField, FittedMethod
from scoup_lab.baselines.rasterised_scene import RasterisedScene
from scoup_lab.data.labels import LabelledFrame
from scoup_lab.evaluate.protocols import selection
from scoup_lab.evaluate.protocols.pixels import LabelledScene
from scoup_lab.evaluate.rules import MaskRule
from scoup_lab.evaluate.scores import SceneScore


@dataclass(frozen=True)
class ScoringRule:
    """A rule from maps to scores."""

    mask_rule: MaskRule  # constants and choice of the level
    levels: tuple[str, ...] | None = None  # names of levels that may answer; None leaves that to the protocol
    everyday: bool = False  # compare with everyday words too (``scoup.models.words``), which no protocol does
    coded: bool = (
        False  # draw only the Gaussians that have a code (``relevancy_of_coded``); of sparse codes only
    )

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

    def maps(
        self, fitted: FittedMethod, rules: Iterable[ScoringRule]
    ) -> Iterator[tuple[LabelledFrame, dict[tuple[bool, bool], Tensor]]]:
        """Yield each labelled frame with its relevancy [S, Q, H, W] for each kind of rule."""
        kinds = sorted({rule.kind for rule in rules})
        plain, scene = self.vectors.canonical, self.rasterised
        phrases = {False: plain, True: with_everyday(plain, self.vectors.everyday)}
        for frame, camera in self.labelled.frames:
            projection = raster.project(scene.gaussians, camera, scene.raster_preset)
            size = self.labelled.map_size(frame, camera)
            queries, by_kind = self.vectors.of(frame.labels), {}
            for everyday, coded in kinds:
                canonical = phrases[everyday]
                if coded:
                    if not isinstance(fitted, FittedField):
                        raise InputError(
                            "only a method of sparse codes has Gaussians without a code to leave out"
                        )
                    maps = relevancy_of_coded(fitted, scene.gaussians, camera, queries, canonical, size)
                else:
                    maps = fitted.relevancy(projection, queries, canonical, size)
                by_kind[everyday, coded] = maps
            yield frame, by_kind

    def score(self, fitted: FittedMethod, rule: MaskRule) -> SceneScore:
        """Return the score by the protocol."""
        return self.scores(fitted, {"": ScoringRule(rule)})[""]

    def scores(self, fitted: FittedMethod, rules: Mapping[str, ScoringRule]) -> dict[str, SceneScore]:
        """Return scores by the name of the rule. Maps are made once a frame for each kind of rule."""
        pairs: dict[str, list] = {name: [] for name in rules}
        protocol = ""
        for frame, maps in self.maps(fitted, rules.values()):
            for name, rule in rules.items():
                score = self._score(frame, maps[rule.kind], rule)
                pairs[name].extend(score.pairs)
                protocol = score.protocol
        return {
            name: SceneScore(self.name, rules[name].mask_rule.name, tuple(of_rule), protocol)
            for name, of_rule in pairs.items()
        }

    def selection_score(self, fitted: FittedMethod) -> SceneScore:
        """Return the score by the 3D-selection protocol."""
        scene = self.rasterised
        return selection.score_method(
            self.labelled, self.vectors, fitted, scene.gaussians, scene.raster_preset
        )

    def _score(self, frame: LabelledFrame, maps: Tensor, rule: ScoringRule) -> SceneScore:
        levels = tuple(self.rasterised.regions.levels)
        if rule.levels is not None:
            # Other levels get the maps of one that may answer: protocols expect all levels.
            maps = maps[[levels.index(name if name in rule.levels else rule.levels[0]) for name in levels]]
        return self.labelled.protocol.score(self.name, [(frame, maps)], rule.mask_rule, levels)


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
