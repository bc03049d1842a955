"""What a field's things are compared with: everyday words and each other."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import torch
from torch import Tensor

from scoup.scene.things import NO_THING, ThingTable

HUB_QUANTILE = 0.99
"""The words that fit a thing best are those above this quantile."""
HUB_SHARE = 0.5
"""This share of the cosine with the words that fit a thing best is subtracted. Chosen by `benchmarks.answer_fit`."""
FEW_REGIONS, UNSTABLE, LEAST_STABILITY = 2.0, 0.25, 0.02
"""The fit of a thing of R regions is lowered by the first / sqrt(R), as the error of a mean falls, and by the second
times the logarithm of 1 / its stability."""
THINGS_AT_A_TIME = 512  # whose fits to all everyday words are in memory together


@dataclass(frozen=True, eq=False)
class ComparedThings:
    """T things compared with B everyday words."""

    things: ThingTable
    words: Tensor  # [B, D]
    embeddings: Tensor  # [T, D] float32
    hubs: Tensor  # [T], the cosine at ``HUB_QUANTILE``
    doubt: Tensor  # [T], how much few regions and instability lower a fit
    counts: Tensor  # [T] float32, Gaussians
    shared: Tensor  # [T, T] sparse float32, Gaussians that two things share
    best_fits: Tensor  # [B] float32, see ``fits_of_words``
    hub_share: float = HUB_SHARE

    @classmethod
    def of(cls, things: ThingTable, words: Tensor, hub_share: float = HUB_SHARE) -> ComparedThings:
        """Compare things with everyday words, or with whatever stands in their place."""
        embeddings = things.embeddings.float().cpu()
        regions, stability = things.n_regions.cpu().clamp(min=1), things.stability.cpu()
        doubt = FEW_REGIONS * regions.rsqrt() - UNSTABLE * stability.clamp(min=LEAST_STABILITY).log()
        rank = max(1, math.ceil(HUB_QUANTILE * len(words)))
        hubs = torch.cat(
            [
                (part @ words.T).kthvalue(rank, dim=1).values
                for part in embeddings.split(THINGS_AT_A_TIME) or [embeddings]
            ]
        )
        counts = things.sums(torch.ones(len(things.owners))).float()
        shared, none = shared_gaussians(things), hubs[:0]
        found = cls(things, words.clone(), embeddings, hubs, doubt, counts, shared, none, hub_share)
        object.__setattr__(found, "best_fits", found.fits_of_words())
        return found

    @cached_property
    def usable(self) -> Tensor:
        """[T] boolean: things that may answer, as they have Gaussians and an embedding."""
        return (self.counts > 0) & self.embeddings.any(1) & (self.things.mass.cpu() > 0)

    def fits(self, queries: Tensor) -> Tensor:
        """Return the fits [T, Q] float32 of all things to unit vectors [Q, D], in units of the scene's spread."""
        return self._fits(self.embeddings @ queries.T, slice(None))

    def _fits(self, cosines: Tensor, rows: slice) -> Tensor:
        lowered = cosines - self.hub_share * self.hubs[rows, None]
        return lowered / self.things.spread - self.doubt[rows, None]

    def fits_of_words(self) -> Tensor:
        """Return the best fit of each everyday word with a thing that it does not name, [B].

        A word names the things that it fits better than all other words. So words of what is in the scene, of which a
        small table may have nothing else, say the same as words of what is not.
        """
        best = torch.full((len(self.words),), -torch.inf)
        for start in range(0, len(self.embeddings), THINGS_AT_A_TIME):
            rows = slice(start, start + THINGS_AT_A_TIME)
            cosines = self.embeddings[rows] @ self.words.T
            fits = self._fits(cosines, rows)
            fits.scatter_(1, cosines.argmax(1, keepdim=True), -torch.inf)
            fits[~self.usable[rows]] = -torch.inf
            best = torch.maximum(best, fits.amax(0))
        return best


def shared_gaussians(things: ThingTable) -> Tensor:
    """Return how many Gaussians each two things share, [T, T] sparse float32; of a thing with itself, all it has."""
    owners, count = things.owners.cpu().long(), len(things)
    every = torch.arange(count)
    places, counts = [torch.stack([every, every])], [things.sums(torch.ones(len(owners))).float()]
    for one, other in combinations(owners.T, 2):
        both = (one != NO_THING) & (other != NO_THING)
        keys, shared = (one[both] * count + other[both]).unique(return_counts=True)
        pairs = torch.stack([keys // max(count, 1), keys % max(count, 1)])
        places += [pairs, pairs.flip(0)]
        counts += [shared.float()] * 2
    size, is_checked = (count, count), False  # said, or torch warns
    return torch.sparse_coo_tensor(
        torch.cat(places, 1), torch.cat(counts), size, check_invariants=is_checked
    ).coalesce()


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
