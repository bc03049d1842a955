"""Which things answer a text, and which are one instance each: compared by the mean embedding of their regions.

The fit of a thing to a text is their cosine, less half of the cosine with the words that fit the thing best: some
things are near to any word (local scaling of cosines, one side of it; Conneau et al. 2018). Its unit is the scene's
spread, by how much the cosines of one thing's regions with a text differ (``ThingTable.spread``), so that a gap means
the same for every embedding model. Things of few regions, and those that views segment differently, fit less: their
means are less certain, and they are more often a part or a blend of what people name.

At each level, the things with the largest fits may answer together, for a text may mean several, or one seen in pieces.
Such a set is judged by four things:

* the gap behind it, to the next thing of its level;
* the distance of its mean fit from the best fit of all things;
* things elsewhere that fit better than its mean count against it; parts of the set and wholes around it do not;
* sets of other levels with the same Gaussians count for it: what several levels found is more often what people name.

The set is chosen once, in the scene. Ours; measured in docs/answers.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import torch
from torch import Tensor

from scoup.field import Field
from scoup.query.question import TextVectors
from scoup.scene.things import NO_THING, ThingTable

HUB_QUANTILE = 0.99
"""The words that fit a thing best are those above this quantile."""
HUB_SHARE = 0.5
"""This share of the cosine with the words that fit a thing best is subtracted."""
FEW_REGIONS, UNSTABLE, LEAST_STABILITY = 2.0, 0.25, 0.02
"""The fit of a thing of R regions is lowered by the first / sqrt(R), as the error of a mean falls, and by the second
times the logarithm of 1 / its stability."""
THINGS_AT_A_TIME = 512  # whose fits to all everyday words are in memory together
MOST_GAP = 3.0
"""The most spreads that a gap counts."""
MOST_TOGETHER = 8
"""Things that may answer together."""
SAME = 0.5
"""Two sets have the same Gaussians from this intersection over union. A thing with at least this share of its Gaussians
in a set, or that share of the set in it, is no rival."""
TEXTS_AT_A_TIME = 16
RIVAL, AGREEMENT = 2.0, 0.25
"""Weights of the choice (docs/answers.md#constants): of the lead of things elsewhere over the mean fit of a set, and of
the score of a set of another level with the same Gaussians."""


@dataclass(frozen=True, eq=False)
class ComparedTable:
    """T things compared with B everyday words."""

    things: ThingTable
    words: Tensor  # [B, D]
    embeddings: Tensor  # [T, D] float32
    hubs: Tensor  # [T], the cosine at ``HUB_QUANTILE``
    doubt: Tensor  # [T], how much few regions and instability lower a fit
    counts: Tensor  # [T] float32, Gaussians
    shared: Tensor  # [T, T] sparse float32, Gaussians that two things share

    @classmethod
    def of(cls, things: ThingTable, words: Tensor) -> ComparedTable:
        """Compare things with everyday words, or with whatever stands in their place."""
        counts = things.sums(torch.ones(len(things.owners))).float()
        hubs = hub_cosines(things, words)
        return cls.known(things, words.clone(), hubs, counts, shared_gaussians(things))

    @classmethod
    def known(
        cls, things: ThingTable, words: Tensor, hubs: Tensor, counts: Tensor, shared: Tensor
    ) -> ComparedTable:
        """Compare things whose Gaussians were counted before; ``owners`` of the table is not read."""
        doubt = doubts(things.n_regions.cpu(), things.stability.cpu())
        return cls(things, words, things.embeddings.float().cpu(), hubs, doubt, counts, shared)

    @property
    def nbytes(self) -> int:
        """Bytes of its largest tensors."""
        return self.words.nbytes + self.embeddings.nbytes

    @cached_property
    def usable(self) -> Tensor:
        """[T] boolean: things that may answer, as they have Gaussians and an embedding."""
        return (self.counts > 0) & self.embeddings.any(1) & (self.things.mass.cpu() > 0)

    def fits(self, queries: Tensor) -> Tensor:
        """Return the fits [T, Q] float32 of all things to unit vectors [Q, D], in units of the scene's spread."""
        return self._fits(self.embeddings @ queries.float().cpu().T, slice(None))

    def _fits(self, cosines: Tensor, rows: slice) -> Tensor:
        lowered = cosines - HUB_SHARE * self.hubs[rows, None]
        return lowered / self.things.spread - self.doubt[rows, None]

    def leads(self, fits: Tensor) -> Tensor:
        """Return how much better things fit texts than the everyday words that fit them best, [T, Q], of their fits."""
        return fits - (1 - HUB_SHARE) * self.hubs[:, None] / self.things.spread

    @cached_property
    def best_fits(self) -> Tensor:
        """The best fit of each everyday word with a thing that it does not name, [B] float32.

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


def doubts(n_regions: Tensor, stability: Tensor) -> Tensor:
    """Return how much few regions and instability lower the fits of things, [T]."""
    return (
        FEW_REGIONS * n_regions.clamp(min=1).rsqrt() - UNSTABLE * stability.clamp(min=LEAST_STABILITY).log()
    )


def hub_cosines(things: ThingTable, words: Tensor) -> Tensor:
    """Return the cosine [T] of each thing with the words [B, D] that fit it best, at ``HUB_QUANTILE``."""
    rank, embeddings = max(1, math.ceil(HUB_QUANTILE * len(words))), things.embeddings.float().cpu()
    parts = embeddings.split(THINGS_AT_A_TIME) or [embeddings]
    return torch.cat([(part @ words.T).kthvalue(rank, dim=1).values for part in parts])


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


@dataclass(frozen=True, eq=False)
class Choice:
    """The things that answer a text."""

    things: Tensor  # [M] int64, M >= 1, of one level, best first
    fit: float  # the best of theirs
    runner_up: int | None  # the thing elsewhere that fits best; None if there is none


def compared_words(texts: TextVectors) -> Tensor:
    """Return the words [B, D] float32 that things are compared with; the canonical phrases replace too few."""
    return (texts.everyday if texts.can_judge_presence else texts.canonical).float().cpu()


def compare_things(field: Field, texts: TextVectors) -> ComparedTable | None:
    """Return the things of a field, compared with ``compared_words``; None for a field without things."""
    if field.thing_table is None or not len(field.thing_table):
        return None
    table, words = field.thing_table, compared_words(texts)
    return field.kept((ComparedTable, words.numpy().tobytes()), lambda: ComparedTable.of(table, words))


def choose_things(known: ComparedTable, fits: Tensor, level: int | None = None) -> list[Choice | None]:
    """Return the things that answer each text.

    Args:
        known: T things of the scene.
        fits: [T, Q], from ``ComparedTable.fits``.
        level: the one that answers; None: the best.

    Returns:
        One per text; None where no thing of the level has a Gaussian and an embedding.
    """
    levels = [
        (known.usable & (known.things.levels.cpu() == each)).nonzero()[:, 0]
        for each in range(known.things.owners.shape[1])
    ]
    choices: list[Choice | None] = []
    for part in fits.T.split(TEXTS_AT_A_TIME):
        choices += _choose(known, part, levels, level)
    return choices


@dataclass(frozen=True, eq=False)
class _Sets:
    """The sets that may answer at one level: the first 1, 2, ... P of its things by their fit, for Q texts."""

    order: Tensor  # [Q, P] things, best first
    sizes: Tensor  # [Q, P] Gaussians of each set
    shared: Tensor  # [Q, P, T] Gaussians that each of these things shares with every thing
    rivals: Tensor  # [Q, P] the thing elsewhere that fits best
    scores: Tensor  # [Q, P] without the other levels

    @classmethod
    def of(cls, known: ComparedTable, fits: Tensor, top: Tensor, middle: Tensor, mine: Tensor) -> _Sets:
        """Return those of one level.

        Args:
            known: as for ``choose_things``.
            fits: [Q, T].
            top, middle: [Q, 1], the best and the median fit of all usable things.
            mine: [M] the usable things of the level, M >= 1.
        """
        ordered, places = fits[:, mine].sort(dim=1, descending=True, stable=True)
        # Behind all things of a level stands a thing like any other.
        ordered = torch.cat([ordered, torch.minimum(middle, ordered[:, -1:])], 1)
        count = min(MOST_TOGETHER, len(mine))
        order = mine[places[:, :count]]
        mass = known.things.mass.cpu()[order]
        mean = (ordered[:, :count] * mass).cumsum(1) / mass.cumsum(1)
        rows = known.shared.index_select(0, order.flatten()).to_dense().view(*order.shape, -1)
        together, sizes = rows.cumsum(1), known.counts[order].cumsum(1)
        inside, around = together / known.counts.clamp(min=1), together / sizes[..., None]
        elsewhere = (inside < SAME) & (around <= SAME) & known.usable
        rival_fits, rivals = torch.where(elsewhere, fits[:, None], -torch.inf).max(2)
        gap = (ordered[:, :count] - ordered[:, 1 : count + 1]).clamp(max=MOST_GAP)
        scores = gap - (top - mean) - RIVAL * (rival_fits - mean).clamp(min=0)
        return cls(order, sizes, rows, torch.where(rival_fits > -torch.inf, rivals, -1), scores)

    def support(self, other: _Sets) -> Tensor:
        """Return [Q, P]: what the best set of another level with the same Gaussians adds to each set."""
        columns = other.order[:, None, :].expand(-1, self.order.shape[1], -1)
        both = self.shared.gather(2, columns).cumsum(1).cumsum(2)  # [Q, P, P of the other]
        same = both > SAME * (self.sizes[:, :, None] + other.sizes[:, None] - both)
        added = torch.where(same, other.scores[:, None] + MOST_GAP, 0.0).amax(2).clamp(min=0)
        return AGREEMENT * added


def _choose(
    known: ComparedTable, fits: Tensor, levels: list[Tensor], level: int | None
) -> list[Choice | None]:
    """``choose_things`` of a few texts, with fits [Q, T]."""
    filled = {number: mine for number, mine in enumerate(levels) if len(mine)}
    wanted = [number for number in filled if level in (None, number)]
    if not wanted:
        return [None] * len(fits)
    usable = torch.where(known.usable, fits, torch.nan)
    top, middle = (
        usable.nan_to_num(-torch.inf).amax(1, keepdim=True),
        usable.nanmedian(1, keepdim=True).values,
    )
    sets = {number: _Sets.of(known, fits, top, middle, mine) for number, mine in filled.items()}
    scores = [
        sets[number].scores + sum(sets[number].support(other) for k, other in sets.items() if k != number)
        for number in wanted
    ]
    ends = torch.tensor([each.shape[1] for each in scores]).cumsum(0)
    choices: list[Choice | None] = []
    for query, best in enumerate(torch.cat(scores, 1).argmax(1).tolist()):
        which = int((ends <= best).sum())
        chosen_sets, place = sets[wanted[which]], best - int(ends[which]) + scores[which].shape[1]
        rival = int(chosen_sets.rivals[query, place])
        things = chosen_sets.order[query, : place + 1]
        choices.append(Choice(things, float(fits[query, things].max()), None if rival < 0 else rival))
    return choices
