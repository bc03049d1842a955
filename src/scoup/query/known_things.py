"""What the fits of a field's things to one text and the next reuse."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from weakref import WeakKeyDictionary

import torch
from torch import Tensor

from scoup import raster
from scoup.scene.things import NO_THING, ThingTable

HUB_QUANTILE = 0.99
"""The words that fit a thing best are those above this quantile."""
FEW_REGIONS, UNSTABLE, LEAST_STABILITY = 2.0, 0.25, 0.02
"""The fit of a thing of R regions is lowered by the first / sqrt(R), as the error of a mean falls, and by the second
times the logarithm of 1 / its stability."""


@dataclass(frozen=True, eq=False)
class ComparedThings:
    """Things compared with words."""

    things: ThingTable
    words: Tensor  # [B, D]
    embeddings: Tensor  # [T, D] float32
    to_words: Tensor  # [T, B], their cosines
    hubs: Tensor  # [T], the cosine at ``HUB_QUANTILE``
    doubt: Tensor  # [T], how much few regions and instability lower a fit
    spread: float
    counts: Tensor  # [T] float64, Gaussians, at least 1
    masses: WeakKeyDictionary[raster.Projection, Tensor] = field(default_factory=WeakKeyDictionary)
    images: WeakKeyDictionary[raster.Projection, Tensor] = field(default_factory=WeakKeyDictionary)

    @classmethod
    def of(cls, things: ThingTable, words: Tensor) -> ComparedThings:
        embeddings = things.embeddings.float().cpu()
        regions, stability = things.n_regions.cpu().clamp(min=1), things.stability.cpu()
        doubt = FEW_REGIONS * regions.rsqrt() - UNSTABLE * stability.clamp(min=LEAST_STABILITY).log()
        counts = things.sums(torch.ones(len(things.owners))).clamp(min=1)
        to_words = embeddings @ words.T
        rank = max(1, math.ceil(HUB_QUANTILE * len(words)))
        hubs = to_words.kthvalue(rank, dim=1).values
        return cls(things, words.clone(), embeddings, to_words, hubs, doubt, things.spread, counts)

    def owned(self, projection: raster.Projection) -> Tensor:
        """[S, H, W] what the Gaussians of any thing of a level contribute to the pixels of a view."""
        if projection not in self.images:
            image = raster.render_values(projection, (self.things.owners != NO_THING).float())
            self.images[projection] = image.permute(2, 0, 1).cpu().contiguous()
        return self.images[projection]

    def mass(self, projection: raster.Projection) -> Tensor:
        """[T + 1] float64: what the Gaussians of each thing contribute to a view, and last what all do."""
        if projection not in self.masses:
            everywhere = torch.zeros(1, projection.height, projection.width, dtype=torch.int32)
            sums = raster.region_sums(projection, everywhere.to(self.things.owners.device))
            gaussian, _, weight = sums.triplets(0)
            total = weight.double().sum().cpu()[None]
            self.masses[projection] = torch.cat([self.things.sums_of(gaussian, weight), total])
        return self.masses[projection]


class KnownThings:
    """The comparison that a field made last. It is replaced as a whole, so that threads may share it; copies start
    empty."""

    def __init__(self) -> None:
        self._last: ComparedThings | None = None

    def __reduce__(self) -> tuple[type[KnownThings], tuple[()]]:
        return KnownThings, ()

    def compared(self, things: ThingTable, words: Tensor) -> ComparedThings:
        """Return things compared with words [B, D], B >= 1."""
        last = self._last
        if last is None or last.things is not things or not torch.equal(last.words, words):
            self._last = last = ComparedThings.of(things, words)
        return last
