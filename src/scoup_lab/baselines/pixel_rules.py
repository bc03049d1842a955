"""Rules for the pixels that count for a Gaussian.

Dense and sparse uplift count every pixel by its blending weight (``AllPixels``). Other systems count fewer: the pixel
at the projected centre of a Gaussian (``CentrePixel``), the same where the Gaussian is visible
(``VisibleInView``), or only those that contribute most to a pixel (``TopContributors``).
Every rule gives region sums of the same form, so that all that comes after can be shared.

The blending weights come from the rasteriser's contract: region sums of a map in which every pixel is a region of its
own.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
import torch
from torch import Tensor

from scoup import raster
from scoup.base import InputError, Progress, no_progress
from scoup.raster import ViewSums, merge
from scoup.scene import Camera
from scoup.uplift import BuildSettings, RegionSums, cameras_with_regions, region_sums

if TYPE_CHECKING:
    from scoup_lab.baselines.rasterised_scene import RasterisedScene

PIXELS_AT_A_TIME = 1 << 17  # a band of rows: some ten million pairs of a Gaussian and a pixel at most


@dataclass(frozen=True, eq=False)
class PixelWeights:
    """Contributions of Gaussians to some pixels."""

    gaussian: np.ndarray  # [T] int64
    pixel: np.ndarray  # [T] int64, row * width + column
    weight: np.ndarray  # [T] float32, the blending weight; positive

    def kept(self, chosen: np.ndarray) -> PixelWeights:
        """Return the pairs [T] boolean alone."""
        return PixelWeights(self.gaussian[chosen], self.pixel[chosen], self.weight[chosen])

    @classmethod
    def joined(cls, parts: Sequence[PixelWeights]) -> PixelWeights:
        """Return the pairs of all parts, one part after the other."""
        return cls(
            np.concatenate([pairs.gaussian for pairs in parts]),
            np.concatenate([pairs.pixel for pairs in parts]),
            np.concatenate([pairs.weight for pairs in parts]),
        )


@dataclass(frozen=True)
class AllPixels:
    """Every pixel counts, by the weight of the Gaussian in it."""

    scale: float | Literal["auto"] = 1.0  # of the images, as in ``BuildSettings``

    def region_sums(self, scene: RasterisedScene, progress: Progress = no_progress) -> RegionSums:
        """Return region sums of all views."""
        settings = BuildSettings(raster_preset=scene.raster_preset, scale=self.scale)
        return region_sums(scene.gaussians, scene.cameras, scene.regions, settings, progress=progress)


ALL_PIXELS = AllPixels()


class PairRule(ABC):
    """A rule that judges each pair of a Gaussian and a pixel it contributes to."""

    @abstractmethod
    def __call__(self, pairs: PixelWeights, centres: np.ndarray) -> PixelWeights:
        """Return the pairs of a band of rows that count; ``centres`` [N] int64 is the pixel under the centre of
        each Gaussian, -1 for none."""

    def of_view(self, pairs: PixelWeights) -> PixelWeights:
        """Filter the pairs of a whole view that count in its bands; by default all count."""
        return pairs

    def region_sums(self, scene: RasterisedScene, progress: Progress = no_progress) -> RegionSums:
        """Return region sums of all views over the pairs that the rule keeps."""
        gaussians, regions = scene.gaussians, scene.regions
        sums = RegionSums.empty(gaussians, regions.levels, scene.raster_preset, scale=1.0)
        views = cameras_with_regions(scene.cameras, regions)
        for done, camera in enumerate(views, start=1):
            labels = regions.load_labels(camera.name, camera.width, camera.height)
            projection = raster.project(gaussians, camera, scene.raster_preset)
            centres = pixels_under(gaussians.means, camera)
            pixels = PixelWeights.joined([self(pairs, centres) for pairs in pixel_weights(projection)])
            sums.append(camera.name, _view_sums(self.of_view(pixels), labels), camera)
            progress("region sums", done, len(views))
        sums.rows = [regions.embeddings(level)[1] for level in regions.levels]
        return sums


PixelRule = AllPixels | PairRule
"""A rule by which pixels count for Gaussians. Equal rules give the same region sums."""


@dataclass(frozen=True)
class CentrePixel(PairRule):
    """The one pixel under the projected centre, by the weight of the Gaussian in it (Occam's LGS)."""

    def __call__(self, pairs: PixelWeights, centres: np.ndarray) -> PixelWeights:
        return pairs.kept(centres[pairs.gaussian] == pairs.pixel)


@dataclass(frozen=True)
class VisibleInView(CentrePixel):
    """The pixel under the centre, for the Gaussians that are seen best in a view by their weights there: the gate of
    VALA's public code (``GaussianModel.accumulate_gaussian_feature_per_view_robust``). Their paper describes a gate for
    each ray (arXiv 2509.05515); the code has one for the view.

    Of n Gaussians that contribute to the pixel under their centre, the heaviest count: as many as make up ``coverage``
    of their sum, as have the weight ``least``, at most n / 2 (but one at least), no more than are heavier
    than ``clear`` or than the quantile ``quantile``, whichever lets more pass.
    """

    # coverage, least: the constants that VALA publishes for LERF (0.9 and 0.01 for ScanNet)
    coverage: float = 0.75
    least: float = 0.13
    # clear, quantile: fixed in that code
    clear: float = 0.15
    quantile: float = 0.85

    def of_view(self, pairs: PixelWeights) -> PixelWeights:
        count = len(pairs.weight)
        if not count:
            return pairs
        order = np.lexsort((pairs.gaussian, -pairs.weight))
        weight = pairs.weight[order].astype(np.float64)
        covering = int((np.cumsum(weight) - weight < self.coverage * weight.sum()).sum())
        first = max(1, min(covering, int((weight >= self.least).sum()), count // 2))
        passing = max((weight > self.clear).sum(), (weight > np.quantile(weight, self.quantile)).sum())
        chosen = np.zeros(count, bool)
        chosen[order[: min(first, int(passing))]] = True
        return pairs.kept(chosen)


@dataclass(frozen=True)
class TopContributors(PairRule):
    """The Gaussians that contribute most to each pixel (Dr. Splat)."""

    count: int = 45  # so many, as published; of equal weights the lower Gaussian

    def __call__(self, pairs: PixelWeights, centres: np.ndarray) -> PixelWeights:
        order, first = _strongest_first(pairs)
        index = np.arange(len(order))
        rank = index - np.maximum.accumulate(np.where(first, index, 0))
        chosen = np.zeros(len(order), bool)
        chosen[order] = rank < self.count
        return pairs.kept(chosen)


def pixel_weights(projection: raster.Projection, pixels: int = PIXELS_AT_A_TIME) -> Iterator[PixelWeights]:
    """Yield all pairs of a Gaussian and a pixel it contributes to, in bands of rows; sorted by Gaussian, then pixel."""
    if pixels < 1:
        raise InputError(f"a band needs at least one pixel, got {pixels}")
    height, width = projection.height, projection.width
    rows = max(1, pixels // width)
    for top in range(0, height, rows):
        bottom = min(height, top + rows)
        labels = torch.full((1, height, width), -1, dtype=torch.int32)
        count = (bottom - top) * width
        labels[0, top:bottom] = torch.arange(count, dtype=torch.int32).view(bottom - top, width)
        gaussian, pixel, weight = (
            tensor.cpu().numpy() for tensor in raster.region_sums(projection, labels).triplets(0)
        )
        yield PixelWeights(gaussian, pixel + top * width, weight)


def pixels_under(points: Tensor, camera: Camera) -> np.ndarray:
    """Return [N] int64: the pixel (row * width + column) that each point [N, 3] projects to; -1 outside the image or
    behind the camera."""
    shown = camera.shows(points)
    columns, rows = torch.where(shown[:, None], camera.pixels(points)[0], 0.0).long().unbind(1)
    return torch.where(shown, rows * camera.width + columns, -1).numpy()


def _strongest_first(pairs: PixelWeights) -> tuple[np.ndarray, np.ndarray]:
    """Return the order of the pairs by pixel, then falling weight, then Gaussian; and where in it a new
    pixel begins."""
    # One key: positive floats are in the order of their bits. Stable, as pairs are sorted by Gaussian.
    bits = pairs.weight.astype(np.float32).view(np.int32).astype(np.int64)
    order = np.argsort((pairs.pixel.astype(np.int64) << 32) - bits, kind="stable")
    return order, np.diff(pairs.pixel[order], prepend=-1) != 0


def _view_sums(pairs: PixelWeights, labels: Tensor) -> ViewSums:
    """Return the pairs whose pixels have a region, summed over the pixels of each combination of regions."""
    combined = raster.combine(labels)
    combination = combined.map.flatten()[torch.from_numpy(pairs.pixel)]
    there = combination >= 0
    gaussian, weight = (torch.from_numpy(array)[there] for array in (pairs.gaussian, pairs.weight))
    return ViewSums(*merge(gaussian, combination[there], weight, max(1, len(combined.table))), combined.table)
