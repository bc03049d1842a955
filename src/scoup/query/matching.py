"""The choice of the things of a scene that answer a text, made once from their fits.

At each level, the things with the largest fits may answer together, for a text may mean several, or one seen in pieces.
Such a set is judged by four things:

* the gap behind it, to the next thing of its level;
* the distance of its mean fit from the best fit of all things;
* things elsewhere that fit better than its mean count against it; parts of the set and wholes around it do not;
* sets of other levels with the same Gaussians count for it: what several levels found is more often what people name.

A set with most of its level's Gaussians has hardly a rival, so it answers only if one of its things fits best of all,
for a scene may be one object, or where nothing else may. Ours; measured in docs/answers.md.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from scoup.query import constants

if TYPE_CHECKING:
    from scoup.query.thing_judge import ThingIndex

FITS_AT_A_TIME = 1 << 16


@dataclass(frozen=True, eq=False)
class Choice:
    """The things that answer a text."""

    things: tuple[int, ...]  # numbers in their scene, of one level, best first, one at least
    level: int
    fit: float  # the best of theirs
    runner_up: int | None  # the thing elsewhere that fits best; None if there is none

    def of(self, things: list[int], level: int, fits: Tensor) -> Choice:
        """Return the choice of other things of a scene with fits [T]; the best one that goes is the runner-up."""
        rival = None if self.runner_up in things else self.runner_up
        lost = [thing for thing in self.things if thing not in things]
        return Choice(tuple(things), level, float(fits[things].max()), lost[0] if lost else rival)


def choose_things(known: ThingIndex, fits: Tensor, level: int | None = None) -> list[list[Choice | None]]:
    """Return for each text the choice of each scene, from fits [N, Q]; None where no thing of the level has a Gaussian
    and an embedding. ``level`` answers, by default the best."""
    starts = torch.tensor(known.starts)
    sizes = starts.diff()
    choices: list[list[Choice | None]] = [[None] * len(sizes) for _ in range(fits.shape[1])]
    order = sizes.argsort(descending=True)  # scenes of similar sizes together, as they are padded
    order = order[sizes[order] > 0]
    while len(order):
        size = int(sizes[order[0]])
        scenes, order = order.tensor_split([max(1, FITS_AT_A_TIME // size)])
        rows = starts[scenes], starts[scenes + 1]
        for texts in torch.arange(fits.shape[1]).split(max(1, FITS_AT_A_TIME // (size * len(scenes)))):
            for scene, text, choice in _choose(known, fits[:, texts], *rows, level):
                choices[int(texts[text])][int(scenes[scene])] = choice
    return choices


@dataclass(frozen=True, eq=False)
class _Sets:
    """The sets that may answer at one level: the first 1, 2, ... P of its things by their fit, for Q texts in S scenes
    of up to T things."""

    order: Tensor  # [S, Q, P] things of the scene, best first
    best: Tensor  # [S, Q] the largest fit
    sizes: Tensor  # [S, Q, P] Gaussians of each set
    shared: Tensor  # [S, Q, P, T] Gaussians that each of these things shares with every thing
    rivals: Tensor  # [S, Q, P] the thing elsewhere that fits best; -1 if there is none
    scores: Tensor  # [S, Q, P] without the other levels; -inf beyond the things of the level
    allowed: Tensor  # [S, Q, P] boolean, without those that have most of the level's Gaussians

    @classmethod
    def of(cls, known: ThingIndex, fits: Tensor, rows: Tensor, usable: Tensor, level: int) -> _Sets:
        """Return the sets of one level, from the rows [S, T] of the things of each scene in the index, which of them
        are usable [S, T], and fits [S, Q, T], -inf for others."""
        top = fits.amax(2, keepdim=True)
        middle = torch.where(usable[:, None], fits, torch.nan).nanmedian(2, keepdim=True).values
        of_level = usable & (known.levels[rows] == level)
        ordered, order = torch.where(of_level[:, None], fits, -torch.inf).sort(
            dim=2, descending=True, stable=True
        )
        ordered, order = ordered[..., : constants.MOST_TOGETHER + 1], order[..., : constants.MOST_TOGETHER]
        count, rank = of_level.sum(1)[:, None, None], torch.arange(constants.MOST_TOGETHER + 1)
        # A thing of median fit follows the last one of a level.
        last = ordered.roll(1, 2)
        ordered = torch.where(rank == count, torch.minimum(middle, last), ordered)
        is_set = (rank[:-1] < count).expand_as(order)
        numbers = rows[torch.arange(len(rows))[:, None, None], order]
        mass = known.mass[numbers]
        mean = (ordered[..., :-1] * mass).cumsum(2) / mass.cumsum(2)
        shared = known.shared(numbers, is_set, fits.shape[2])
        together, sizes = shared.cumsum(2), known.counts[numbers].cumsum(2)
        inside = together / known.counts[rows].clamp(min=1)[:, None, None]
        around = together / sizes[..., None]
        elsewhere = (
            (inside < constants.SAME_GAUSSIANS) & (around <= constants.SAME_GAUSSIANS) & usable[:, None, None]
        )
        rival_fits, rivals = torch.where(elsewhere, fits[:, :, None], -torch.inf).max(3)
        owned = (known.counts[rows] * of_level).sum(1)[:, None, None]
        gap = (ordered[..., :-1] - ordered[..., 1:]).clamp(max=constants.MOST_GAP)
        scores = gap - (top - mean) - constants.RIVAL * (rival_fits - mean).clamp(min=0)
        return cls(
            order,
            ordered[..., 0],
            sizes,
            shared,
            torch.where(rival_fits > -torch.inf, rivals, -1),
            torch.where(is_set, scores, -torch.inf),
            (sizes <= constants.MOST_COVERED * owned) | (ordered[..., :1] == top),
        )

    def support(self, other: _Sets) -> Tensor:
        """Return [S, Q, P], the bonus of each set for the best set of another level with the same Gaussians."""
        columns = other.order[:, :, None, :].expand(-1, -1, constants.MOST_TOGETHER, -1)
        both = self.shared.gather(3, columns).cumsum(2).cumsum(3)  # [S, Q, P, P of the other]
        same = both > constants.SAME_GAUSSIANS * (self.sizes[..., None] + other.sizes[:, :, None] - both)
        added = torch.where(same, other.scores[:, :, None] + constants.MOST_GAP, 0.0).amax(3).clamp(min=0)
        return constants.AGREEMENT * added


def _choose(
    known: ThingIndex, fits: Tensor, starts: Tensor, ends: Tensor, level: int | None
) -> Iterator[tuple[int, int, Choice]]:
    """Yield the index of a scene, the index of a text, and their choice, for some scenes and texts with fits [N, Q]."""
    width = max(int((ends - starts).max()), constants.MOST_TOGETHER + 1)
    rows = starts[:, None] + torch.arange(width)
    there = rows < ends[:, None]
    rows = torch.where(there, rows, starts[:, None])
    usable = known.usable[rows] & there
    fits = torch.where(usable[..., None], fits[rows], -torch.inf).transpose(1, 2).contiguous()
    levels = known.levels[rows][usable].unique().tolist()
    sets = {one: _Sets.of(known, fits, rows, usable, one) for one in levels}
    wanted = [one for one in levels if level in (None, one)]
    if not wanted:
        return
    scores = [
        sets[one].scores + sum(sets[one].support(other) for k, other in sets.items() if k != one)
        for one in wanted
    ]
    score = torch.cat(scores, 2)
    allowed = torch.where(torch.cat([sets[one].allowed for one in wanted], 2), score, -torch.inf)
    score, best = torch.where(allowed.amax(2, keepdim=True) > -torch.inf, allowed, score).max(2)
    which, rank = best // constants.MOST_TOGETHER, best % constants.MOST_TOGETHER
    at = which[..., None]
    order = torch.stack([sets[one].order for one in wanted], 2)
    order = order.gather(2, at[..., None].expand(-1, -1, 1, constants.MOST_TOGETHER))[:, :, 0].tolist()
    fit = torch.stack([sets[one].best for one in wanted], 2).gather(2, at)[..., 0].tolist()
    rivals = torch.cat([sets[one].rivals for one in wanted], 2).gather(2, best[..., None])[..., 0].tolist()
    ranks, kinds = rank.tolist(), which.tolist()
    for scene, text in (score > -torch.inf).nonzero().tolist():
        things, rival = order[scene][text][: ranks[scene][text] + 1], rivals[scene][text]
        kind = wanted[kinds[scene][text]]
        yield scene, text, Choice(tuple(things), kind, fit[scene][text], None if rival < 0 else rival)
