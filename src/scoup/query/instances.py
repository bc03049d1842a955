"""The instances that a text means, to be counted.

Things that answer are too many where parts or neighbours answer as well, and too few where only some instances do.
Instances of one name fit it alike and look alike, so both are asked of every thing of the answer's level. Finer things
are not counted: under a thing that fits, those that fit alike are parts of one object more often than several objects.
Ours; measured in docs/things.md.
"""

from __future__ import annotations

import torch
from torch import Tensor

from scoup.query.known_things import ComparedThings

FIT_SHARE = 0.17
"""An instance fits at most so much less than the best thing, as a share of the best fit's distance from the median."""
LEAST_LIKENESS = 0.65
"""Least cosine of an instance's embedding with that of the best thing, both less the mean embedding of all things."""


def find_instances(known: ComparedThings, fits: Tensor, chosen: Tensor) -> Tensor:
    """Return the things [I] int64 of the level of an answer that are one instance each, best first, I >= 1.

    Args:
        known: T things of the scene.
        fits: [T] of the text.
        chosen: [M] int64, the things that answer, M >= 1.
    """
    levels = known.things.levels.long().cpu()
    best = fits.argmax()
    looks = torch.nn.functional.normalize(known.embeddings - known.embeddings.mean(0), dim=1)
    near = fits[best] - fits <= FIT_SHARE * (fits[best] - fits.quantile(0.5))
    alike = near & (looks @ looks[best] >= LEAST_LIKENESS) & known.usable
    found = (alike & (levels == levels[chosen[0]])).nonzero()[:, 0]
    if not len(found):
        return chosen[:1]
    return found[fits[found].argsort(descending=True, stable=True)]
