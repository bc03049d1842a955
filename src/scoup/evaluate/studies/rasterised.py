"""A scene rasterised once, on which many ways of coding, lifting and answering are tried."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import torch
from torch import Tensor

from scoup import raster
from scoup.base.progress import Progress, no_progress
from scoup.baselines.channels import ChannelField
from scoup.baselines.pixel_rules import Gather, gathered_sums
from scoup.evaluate.datasets import DataSet, EvalScene
from scoup.evaluate.scores import SceneScore
from scoup.evaluate.scoring import Asked, map_size, score
from scoup.io import default_preset, load_gaussians, load_regions
from scoup.io.labels import LabelledFrame
from scoup.models.words import with_everyday
from scoup.query.presets import QueryPreset
from scoup.scene.cameras import Cameras
from scoup.scene.gaussians import Gaussians
from scoup.scene.regions import RegionMap, Regions
from scoup.uplift.rasterise import region_sums
from scoup.uplift.region_sums import RegionSums


@dataclass(frozen=True)
class Rule:
    """How maps become scores.

    Attributes:
        preset: constants and choice of the level.
        levels: names of those asked; None asks all that the protocol asks.
        everyday: ask beside everyday words (``scoup.models.words``), which no protocol does.
    """

    preset: QueryPreset
    levels: tuple[str, ...] | None = None
    everyday: bool = False


@dataclass(frozen=True, eq=False)
class PreparedScene:
    """All that ways of answering share. Made by ``prepare_scene``.

    Attributes:
        data_set, scene, asked: what is scored.
        gaussians: N of them.
        cameras: views with regions, and those labelled.
        regions: maps and embeddings.
        raster_preset: rasteriser constants.
        sums: region sums by the rule that gathered them (None: all blending weights), made when first asked for.
        seconds: what making them took.
    """

    data_set: DataSet
    scene: EvalScene
    asked: Asked
    gaussians: Gaussians
    cameras: Cameras
    regions: Regions
    raster_preset: str
    sums: dict[Gather | None, RegionSums] = field(default_factory=dict)
    seconds: dict[Gather | None, float] = field(default_factory=dict)

    @property
    def name(self) -> str:
        return self.scene.name

    def embeddings(self) -> list[Tensor]:
        """Per level [R, D]."""
        return [self.regions.embeddings(level)[0] for level in self.regions.levels]

    def gathered(self, gather: Gather | None = None, progress: Progress = no_progress) -> RegionSums:
        """Region sums by a rule, kept for the next time."""
        if gather not in self.sums:
            started = time.perf_counter()
            if gather is None:
                made = region_sums(
                    self.gaussians, self.cameras, self.regions, self.raster_preset, progress=progress
                )
            else:
                made = gathered_sums(
                    self.gaussians,
                    self.cameras,
                    self.regions,
                    gather,
                    self.raster_preset,
                    progress=progress,
                )
            self.sums[gather] = made
            self.seconds[gather] = time.perf_counter() - started
        return self.sums[gather]

    def maps(
        self, made: ChannelField, canonical: Sequence[Tensor]
    ) -> Iterator[tuple[LabelledFrame, list[Tensor]]]:
        """Each labelled frame with its relevancy [S, Q, H, W] beside each set of canonical vectors [P, D]."""
        for frame, camera in self.scene.frames:
            view = raster.project(self.gaussians, camera, self.raster_preset)
            size = map_size(self.data_set, frame, camera)
            queries = self.asked.of(frame.labels)
            yield frame, [made.relevancy(view, queries, each, size) for each in canonical]

    def scores(self, made: ChannelField, rules: Mapping[str, Rule]) -> dict[str, SceneScore]:
        """Scores by the name of the rule; maps are made once a frame, and once more beside everyday words."""
        pairs: dict[str, list] = {name: [] for name in rules}
        protocol = ""
        kinds = sorted({rule.everyday for rule in rules.values()})
        plain = self.asked.canonical
        beside = [with_everyday(plain, self.asked.everyday) if everyday else plain for everyday in kinds]
        for frame, maps in self.maps(made, beside):
            for name, rule in rules.items():
                part = self._score(frame, maps[kinds.index(rule.everyday)], rule)
                pairs[name].extend(part.pairs)
                protocol = part.protocol
        return {
            name: SceneScore(self.name, rules[name].preset.name, tuple(of_rule), protocol)
            for name, of_rule in pairs.items()
        }

    def _score(self, frame: LabelledFrame, maps: Tensor, rule: Rule) -> SceneScore:
        levels = self.regions.levels
        if rule.levels is None:
            return score(self.data_set, self.name, iter([(frame, maps)]), rule.preset, levels)
        # Levels that are not asked get the maps of one that is: the protocol sees as many as ever.
        rows = [levels.index(name if name in rule.levels else rule.levels[0]) for name in levels]
        return score(self.data_set, self.name, iter([(frame, maps[rows])]), rule.preset, levels)


def prepare_scene(data_set: DataSet, scene: EvalScene, asked: Asked) -> PreparedScene:
    """Load the splat and open the regions; nothing is rasterised yet."""
    gaussians = load_gaussians(scene.splat)
    regions = load_regions(scene.features, scene.cameras)
    return PreparedScene(
        data_set, scene, asked, gaussians, scene.cameras, regions, default_preset(scene.splat)
    )


def of_views(regions: Regions, names: Sequence[str]) -> Regions:
    """The regions of some views, in the order they are in."""
    wanted = set(names)
    return regions.select(name for name in regions.view_names if name in wanted)


def every_nth_pixel(regions: Regions, stride: int) -> Regions:
    """The regions with labels at every ``stride``-th pixel of every ``stride``-th row alone."""

    def load(view: str, level: str) -> RegionMap:
        found = regions.load(view, level)
        labels = torch.full_like(found.labels, -1)
        labels[stride // 2 :: stride, stride // 2 :: stride] = found.labels[
            stride // 2 :: stride, stride // 2 :: stride
        ]
        return RegionMap(labels, found.embeddings)

    return Regions(regions.levels, regions.view_names, load, regions.load_embeddings)
