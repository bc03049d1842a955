"""Things that answer a text: instances compared by the mean embedding of their regions.

The fit of a thing to a text is their cosine, less half of the cosine with the words that fit the thing best: some
things are near to any word (local scaling of cosines, one side of it; Conneau et al. 2018). Its unit is the scene's
spread, by how much the cosines of one thing's regions with a text differ (``ThingTable.spread``), so that a gap means
the same for every embedding model. Things of few regions, and those that views segment differently, fit less: their
means are less certain, and they are more often a part or a blend of what people name.

At each level, the things with the largest fits may answer together, for a text may mean several, or one seen in pieces.
A set is judged by the gap behind it, by the distance of its mean fit from the best of all levels, and by its overlap
with what the votes of the Gaussians select (``scoup.query.segment``, ``scoup.query.select``). The less the regions of
one thing agree over the views, the more the votes count; they alone answer where no set is convincing. Ours; measured
in docs/answers.md.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from scoup import raster
from scoup.query.coded_scene import CodedScene
from scoup.query.known_things import ComparedThings, KnownThings
from scoup.query.presence import other_words, word_leads
from scoup.query.text_vectors import TextVectors
from scoup.scene.things import ThingTable

HUB_SHARE = 0.5
"""This share of the cosine with the words that fit a thing best is subtracted."""
MOST_GAP = 3.0
"""The most spreads that a gap behind a set counts."""
VOTES, LEAST_SCORE = 8.0, 0.5
"""The weight of overlap with the votes, times the disagreement of the things' regions; and the score, without that,
from which a set is convincing."""
STANDS_OUT = 2.25
"""The best of some hundred things stands out among them by so many standard deviations for any text."""
AT_A_TIME = 7  # texts in one pass over a view
LEAST_PART = 1e-4
"""Things with a smaller share of the whole mass are not visible in a view."""


@dataclass(frozen=True, eq=False)
class ThingFits:
    """The fits of T things to Q texts, and what they are judged by."""

    things: ThingTable
    fits: Tensor  # [T, Q] float32 in units of the spread
    cosines: Tensor  # [T, Q] float32, with the texts
    others: Tensor  # [Q, B] boolean, from ``other_words``
    known: ComparedThings

    @classmethod
    def of(cls, things: ThingTable, texts: TextVectors, known_things: KnownThings | None = None) -> ThingFits:
        """Compare all things with all texts, on the CPU; canonical phrases replace too few everyday words."""
        words = (texts.everyday if texts.can_judge_presence else texts.canonical).float().cpu()
        queries = texts.queries.float().cpu()
        known = (known_things or KnownThings()).compared(things, words)
        cosines = known.embeddings @ queries.T
        fits = (cosines - HUB_SHARE * known.hubs[:, None]) / known.spread - known.doubt[:, None]
        return cls(things, fits, cosines, other_words(queries, words), known)

    @property
    def to_words(self) -> Tensor:
        """Cosines with everyday words, [T, B] float32."""
        return self.known.to_words

    def presence(self, query: int, seen: Tensor | None = None) -> float:
        """Return the score of a text among the things seen [T] boolean, or all; minus infinity if there is none.

        It is the lead of the text over other words at the best thing, plus the lead of this thing over other things
        beyond that of any text; both in standard deviations.
        """
        fits = self.fits[:, query].double()
        if seen is None:
            seen = torch.ones(len(fits), dtype=torch.bool)
        if not bool(seen.any()):
            return -math.inf
        best = int(torch.where(seen, fits, -torch.inf).argmax())
        mine = slice(query, query + 1)
        lead = float(
            word_leads(self.cosines[best, mine], self.to_words[best : best + 1], self.others[mine])[0]
        )
        deviation = float(fits.std()) if len(fits) > 1 else 0.0
        return lead + float(fits[best] - fits.mean()) / max(deviation, 1e-6) - STANDS_OUT


def thing_fits(field: CodedScene, texts: TextVectors) -> ThingFits | None:
    """Return the fits of a field's things to texts; None for a field without things."""
    table = field.thing_table
    return None if table is None else ThingFits.of(table, texts, field.known_things)


def thing_of_scene(
    fits: ThingFits, query: int, selected: Tensor, level: int | None = None
) -> tuple[Tensor, int] | None:
    """Return the Gaussians [N] boolean of ``things_of_scene``, and their level."""
    chosen, things = things_of_scene(fits, query, selected, level), fits.things
    return None if chosen is None else (things.members(chosen), int(things.levels[chosen[0]]))


def things_of_scene(fits: ThingFits, query: int, selected: Tensor, level: int | None = None) -> Tensor | None:
    """Return the things [M] int64 of one level that answer a text in the scene; None where the votes answer.

    Args:
        fits: of all texts.
        query: position of the text.
        selected: [N] boolean, the Gaussians that the votes select.
        level: the one that answers; None: the best.
    """
    things = fits.things
    mass = things.mass.double().cpu()
    voted = mass * things.sums(selected) / fits.known.counts  # Gaussians of one thing count alike
    all_voted = torch.zeros(things.owners.shape[1], dtype=torch.float64)
    all_voted.index_add_(0, things.levels.long().cpu(), voted)
    return choose_things(things, fits.fits[:, query], mass, voted, all_voted, level)


def things_in_mask(table: ThingTable, mask: Tensor, level: int) -> Tensor:
    """Return the things [M] int64 of a level of which at least half the Gaussians are in a mask [N] boolean."""
    owners = table.owners[:, level].cpu().long() + 1
    within = torch.bincount(owners[mask.cpu()], minlength=len(table) + 1)[1:]
    total = torch.bincount(owners, minlength=len(table) + 1)[1:]
    return ((within > 0) & (2 * within >= total)).nonzero()[:, 0]


@dataclass(frozen=True, eq=False)
class ThingsSeen:
    """The things that answer texts in a view."""

    masks: list[
        tuple[Tensor, int] | None
    ]  # per text [H, W] on the CPU, and the level; None: the votes answer
    presence: list[float]  # per text, see ``ThingFits.presence``


def things_of_view(
    fits: ThingFits, projection: raster.Projection, voted: Sequence[Tensor], level: int | None = None
) -> ThingsSeen:
    """Return the pixels of the things that answer each text in a view.

    The things contribute more to these pixels than all other things of their level. Gaussians of no thing, such as haze
    before the camera, do not count.

    Args:
        fits: of Q texts.
        projection: of the scene to the camera.
        voted: per text [H, W] boolean, the pixels that the votes select.
        level: the one that answers; None: the best.
    """
    things, masks, presence = fits.things, [], []
    mass, whole = fits.known.mass(projection).split([len(things), 1])
    seen = mass > LEAST_PART * whole
    for start in range(0, len(voted), AT_A_TIME):
        part = voted[start : start + AT_A_TIME]
        sums = raster.region_sums(projection, torch.stack([mask.int() - 1 for mask in part]))
        chosen: list[Tensor | None] = []
        for number in range(len(part)):
            query = start + number
            gaussian, _, weight = sums.triplets(number)
            inside = things.sums_of(gaussian, weight)
            all_voted = weight.double().sum().cpu().expand(things.owners.shape[1])
            chosen.append(choose_things(things, fits.fits[:, query], mass, inside, all_voted, level))
            presence.append(fits.presence(query, seen))
        masks += _rendered(fits.known, projection, chosen)
    return ThingsSeen(masks, presence)


def _rendered(
    known: ComparedThings, projection: raster.Projection, chosen: Sequence[Tensor | None]
) -> list[tuple[Tensor, int] | None]:
    """The masks [H, W] of things, with their levels."""
    things = known.things
    there = [each for each in chosen if each is not None]
    if not there:
        return [None] * len(chosen)
    owned = known.owned(projection)
    shares = iter(
        raster.render_values(projection, torch.stack([things.members(each) for each in there], 1).float())
        .cpu()
        .unbind(-1)
    )
    found: list[tuple[Tensor, int] | None] = []
    for each in chosen:
        if each is None:
            found.append(None)
            continue
        level = int(things.levels[each[0]])
        mask = next(shares) > 0.5 * owned[level]
        found.append((mask, level) if bool(mask.any()) else None)
    return found


def choose_things(
    things: ThingTable,
    fits: Tensor,
    mass: Tensor,
    voted: Tensor,
    voted_mass: Tensor,
    level: int | None = None,
) -> Tensor | None:
    """Return the things of one level that answer a text together; None where the votes answer.

    Args:
        things: of the scene.
        fits: [T] of the text.
        mass: [T] float64, weight of each thing in a view, or in the scene.
        voted: [T] float64, the part of it that the votes select.
        voted_mass: [S] float64, all that the votes select, per level.
        level: the one that answers, judged by the best fit of all levels; None: the best.

    Returns:
        [M] int64, M >= 1, best first.
    """
    seen = (mass > LEAST_PART * mass.sum()) & (things.embeddings.any(1).cpu())
    weight = VOTES * things.disagreement
    best_score, chosen = LEAST_SCORE + weight, None
    top = float(fits[seen].max()) if bool(seen.any()) else 0.0
    # Behind all things of a level stands a thing like any other.
    middle = (
        fits[seen].double().median().reshape(1) if bool(seen.any()) else torch.zeros(1, dtype=torch.float64)
    )
    for each in range(things.owners.shape[1]) if level is None else (level,):
        mine = (seen & (things.levels.cpu() == each)).nonzero()[:, 0]
        if not len(mine):
            continue
        mine = mine[fits[mine].argsort(descending=True, stable=True)]
        ordered, sizes = fits[mine].double(), mass[mine]
        area, inside = sizes.cumsum(0), voted[mine].cumsum(0)
        mean = (ordered * sizes).cumsum(0) / area
        behind = torch.cat([ordered[1:], middle.clamp(max=ordered[-1])])
        gap = (ordered - behind).clamp(max=MOST_GAP)
        overlap = inside / (area + voted_mass[each] - inside).clamp(min=1e-9)
        scores = gap - (top - mean) + weight * overlap
        place = int(scores.argmax())
        if float(scores[place]) > best_score:
            best_score, chosen = float(scores[place]), mine[: place + 1]
    return chosen
