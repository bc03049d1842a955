"""Things that answer a text: instances compared by the mean embedding of their regions.

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

from dataclasses import dataclass

import torch
from torch import Tensor

from scoup.query.coded_scene import CodedScene
from scoup.query.known_things import ComparedThings
from scoup.query.text_vectors import TextVectors


@dataclass(frozen=True)
class ChoiceRule:
    """Weights of the choice, chosen by `benchmarks.answer_fit`."""

    rival: float = 2.0
    """Of the lead of things elsewhere over the mean fit of a set."""
    agreement: float = 0.25
    """Of the score of a set of another level with the same Gaussians."""


CHOICE_RULE = ChoiceRule()
MOST_GAP = 3.0
"""The most spreads that a gap counts."""
MOST_TOGETHER = 8
"""Things that may answer together."""
SAME = 0.5
"""Two sets have the same Gaussians from this intersection over union. A thing with at least this share of its Gaussians
in a set, or that share of the set in it, is no rival."""
TEXTS_AT_A_TIME = 16


@dataclass(frozen=True, eq=False)
class ChosenThings:
    """The things that answer a text."""

    things: Tensor  # [M] int64, M >= 1, of one level, best first
    fit: float  # the best of theirs
    runner_up: int | None  # the thing elsewhere that fits best; None if there is none


def compare_things(field: CodedScene, texts: TextVectors) -> ComparedThings | None:
    """Return the things of a field, compared with everyday words; None for a field without things.

    The canonical phrases replace too few everyday words.
    """
    if field.thing_table is None or not len(field.thing_table):
        return None
    words = (texts.everyday if texts.can_judge_presence else texts.canonical).float().cpu()
    return field.known_things.compared(field.thing_table, words)


def choose_things(
    known: ComparedThings, fits: Tensor, level: int | None = None, rule: ChoiceRule = CHOICE_RULE
) -> list[ChosenThings | None]:
    """Return the things that answer each text.

    Args:
        known: T things of the scene.
        fits: [T, Q], from ``ComparedThings.fits``.
        level: the one that answers; None: the best.
        rule: the weights.

    Returns:
        One per text; None where no thing of the level has a Gaussian and an embedding.
    """
    levels = [
        (known.usable & (known.things.levels.cpu() == each)).nonzero()[:, 0]
        for each in range(known.things.owners.shape[1])
    ]
    found: list[ChosenThings | None] = []
    for part in fits.T.split(TEXTS_AT_A_TIME):
        found += _choose(known, part, levels, level, rule)
    return found


@dataclass(frozen=True, eq=False)
class _Sets:
    """The sets that may answer at one level: the first 1, 2, ... P of its things by their fit, for Q texts."""

    order: Tensor  # [Q, P] things, best first
    sizes: Tensor  # [Q, P] Gaussians of each set
    shared: Tensor  # [Q, P, T] Gaussians that each of these things shares with every thing
    rivals: Tensor  # [Q, P] the thing elsewhere that fits best
    scores: Tensor  # [Q, P] without the other levels
    rule: ChoiceRule

    @classmethod
    def of(cls, known: ComparedThings, fits: Tensor, mine: Tensor, rule: ChoiceRule) -> _Sets:
        """Return those of fits [Q, T] and the things of one level [M], M >= 1."""
        wanted = torch.where(known.usable, fits, torch.nan)
        top, middle = (
            wanted.nan_to_num(-torch.inf).amax(1, keepdim=True),
            wanted.nanmedian(1, keepdim=True).values,
        )
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
        scores = gap - (top - mean) - rule.rival * (rival_fits - mean).clamp(min=0)
        return cls(order, sizes, rows, torch.where(rival_fits > -torch.inf, rivals, -1), scores, rule)

    def support(self, other: _Sets) -> Tensor:
        """Return [Q, P]: what the best set of another level with the same Gaussians adds to each set."""
        columns = other.order[:, None, :].expand(-1, self.order.shape[1], -1)
        both = self.shared.gather(2, columns).cumsum(1).cumsum(2)  # [Q, P, P of the other]
        same = both > SAME * (self.sizes[:, :, None] + other.sizes[:, None] - both)
        added = torch.where(same, other.scores[:, None] + MOST_GAP, 0.0).amax(2).clamp(min=0)
        return self.rule.agreement * added


def _choose(
    known: ComparedThings,
    fits: Tensor,
    levels: list[Tensor],
    level: int | None,
    rule: ChoiceRule,
) -> list[ChosenThings | None]:
    """``choose_things`` of a few texts, with fits [Q, T]."""
    sets = {number: _Sets.of(known, fits, mine, rule) for number, mine in enumerate(levels) if len(mine)}
    wanted = [number for number in sets if level in (None, number)]
    if not wanted:
        return [None] * len(fits)
    scores = [
        sets[number].scores + sum(sets[number].support(other) for k, other in sets.items() if k != number)
        for number in wanted
    ]
    ends = torch.tensor([each.shape[1] for each in scores]).cumsum(0)
    found: list[ChosenThings | None] = []
    for query, best in enumerate(torch.cat(scores, 1).argmax(1).tolist()):
        which = int((ends <= best).sum())
        own, place = sets[wanted[which]], best - int(ends[which]) + scores[which].shape[1]
        rival = int(own.rivals[query, place])
        things = own.order[query, : place + 1]
        found.append(ChosenThings(things, float(fits[query, things].max()), None if rival < 0 else rival))
    return found
