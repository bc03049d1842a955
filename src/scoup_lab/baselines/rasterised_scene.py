"""A scene that is rasterised once and to which many methods are then fitted."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

from torch import Tensor

from scoup.base import Progress, no_progress
from scoup.field import ThingTable
from scoup.scene import Cameras, Gaussians, Regions, SparseCodes
from scoup.uplift import (
    BuildSettings,
    RegionEmbeddings,
    RegionSums,
    cameras_with_regions,
    code_regions,
    find_things,
    scene_preset,
)
from scoup_lab.baselines.pixel_rules import ALL_PIXELS, PixelRule

Codes = tuple[list[SparseCodes], Tensor]
"""Codes of the regions of each level, and the codebook [S, L, D]."""


@dataclass(frozen=True, eq=False)
class UpliftInputs:
    """The inputs of a method."""

    sums: RegionSums  # region sums
    embeddings: Sequence[Tensor]  # per level [R, D], of the regions of these sums
    # codes learned so far, by settings
    kept_codes: dict[BuildSettings, Codes] = field(default_factory=dict)
    # the things of these sums, once they are known
    kept_things: list[ThingTable] = field(default_factory=list)
    # for methods that render; None where only sums are at hand
    scene: RasterisedScene | None = None

    def codes(self, settings: BuildSettings, progress: Progress = no_progress) -> Codes:
        """Return codes of the embeddings, learned once for all settings that differ in the vote only."""
        of_codes = _of_codes(settings)
        if of_codes not in self.kept_codes:
            embeddings = RegionEmbeddings(self.sums.levels, self.embeddings, [])
            learned = code_regions(embeddings, settings, progress=progress)
            self.kept_codes[of_codes] = list(learned.codes), learned.codebook
        return self.kept_codes[of_codes]

    def things(self) -> ThingTable:
        """Return the instances of the scene, made once."""
        if not self.kept_things:
            self.kept_things.append(find_things(self.sums, self.embeddings).table)
        return self.kept_things[0]


def _of_codes(settings: BuildSettings) -> BuildSettings:
    return replace(settings, keep=0, rounds=1, scale="auto", things=False)


class RasterisedScene:
    """The region sums of a scene, made when they are first needed and kept.

    ``preset``: of the rasteriser; its near plane is replaced where it cuts what the cameras see, as in ``scoup.build``.
    """

    def __init__(
        self, gaussians: Gaussians, cameras: Cameras, regions: Regions, preset: str = "inria"
    ) -> None:
        self.gaussians = gaussians
        self.cameras = cameras
        self.regions = regions
        self._preset = preset
        self._sums: dict[PixelRule, RegionSums] = {}
        self._seconds: dict[PixelRule, float] = {}
        self._codes: dict[BuildSettings, Codes] = {}

    @cached_property
    def raster_preset(self) -> str:
        """The preset with the near plane of the scene."""
        return scene_preset(self.gaussians, cameras_with_regions(self.cameras, self.regions), self._preset)

    def region_sums(self, pixels: PixelRule = ALL_PIXELS, progress: Progress = no_progress) -> RegionSums:
        """Return region sums of the pixels that count by a rule."""
        if pixels not in self._sums:
            _ = self.raster_preset  # its seconds do not count
            started = time.perf_counter()
            self._sums[pixels] = pixels.region_sums(self, progress)
            self._seconds[pixels] = time.perf_counter() - started
        return self._sums[pixels]

    def seconds(self, pixels: PixelRule = ALL_PIXELS) -> float:
        """Return the seconds that the region sums of a rule took."""
        self.region_sums(pixels)
        return self._seconds[pixels]

    @cached_property
    def _embeddings(self) -> list[Tensor]:
        return [self.regions.embeddings(level)[0] for level in self.regions.levels]

    def inputs(self, pixels: PixelRule = ALL_PIXELS, progress: Progress = no_progress) -> UpliftInputs:
        """Return the inputs of a method."""
        return UpliftInputs(self.region_sums(pixels, progress), self._embeddings, self._codes, scene=self)

    def forget_codes(self) -> None:
        """Drop the codes learned so far: the next method learns its own."""
        self._codes = {}
