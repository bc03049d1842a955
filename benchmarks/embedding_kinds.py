"""Kinds of embedding models and segmenters whose statistics the draws of the kitchen can have.

A kind says how alike prototypes are, which cosines they have with words, and how regions differ from them. Cosines
with words are drawn once per (thing, word) and are the same in all views. So are the things that have no region of
their own. Such errors are systematic: no vote over views removes them.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from scoup.models import CANONICAL_PHRASES
from scoup_lab.synthetic.art.meshes import Floats
from scoup_lab.synthetic.observe import SWAPPED
from scoup_lab.synthetic.words import unit

PHRASE_SPREAD = 0.01  # standard deviation of a prototype's cosine with a canonical phrase


@dataclass(frozen=True)
class RegionErrors:
    """Errors of regions and their embeddings. The defaults are those of a draw without a kind."""

    noise: float = 1.0  # factor of all noise of the embeddings
    # spread of the noise over regions: the standard deviation of the logarithm of its factor
    tail: float = 0.0
    wrong: float = SWAPPED  # share of the regions per view that carry the embedding of a neighbour
    swallowed: float = 0.0  # share of the things that have no region of their own at level m in any view


@dataclass(frozen=True)
class EmbeddingKind:
    """Statistics of an embedding model, and of the segmenter in front of it."""

    title: str  # for tables
    # squared length of what all prototypes have in common. The median cosine of two prototypes is a little
    # lower, since their cosines with words differ.
    common: float
    # in how many directions prototypes differ otherwise. The fewer, the more their cosines vary.
    dimensions: int
    own: tuple[float, float]  # mean and standard deviation of the cosine of a thing with its own name
    others: tuple[float, float]  # the same with the names of other things
    phrases: float  # mean cosine of a thing with a canonical phrase
    errors: RegionErrors = field(default_factory=RegionErrors)  # of regions


KINDS = {
    "desk": EmbeddingKind(
        "desk's statistics",
        common=0.53,
        dimensions=12,
        own=(0.077, 0.03),
        others=(0.014, 0.02),
        phrases=0.015,
        errors=RegionErrors(noise=0.2, tail=1.0, wrong=0.01, swallowed=0.2),
    ),
    "clip": EmbeddingKind(
        "CLIP's statistics",
        common=0.92,
        dimensions=5,
        own=(0.26, 0.02),
        others=(0.19, 0.02),
        phrases=0.2,
        errors=RegionErrors(noise=0.65, tail=0.3, wrong=0.03, swallowed=0.1),
    ),
}
"""By the suffix of a scene's name. "desk" follows the real scene of that name: a detector's dense features and
MobileSAM's masks. "clip" follows real embeddings of image crops by CLIP ViT-B/16."""


def draw_prototypes(
    kind: EmbeddingKind,
    words: Mapping[str, Floats],
    of_name: Mapping[str, Sequence[int]],
    count: int,
    rng: np.random.Generator,
) -> Floats:
    """Draw unit image prototypes [count, D] with the cosines of a kind.

    ``words``: word -> [D] unit text vector, the names and the canonical phrases among them; ``of_name``: name
    -> the objects that it is the own name of.
    """
    vectors = np.stack([words[word] for word in (*of_name, *CANONICAL_PHRASES)])
    vectors = np.concatenate([vectors, np.mean(list(words.values()), 0)[None]])
    phrases = np.full(len(CANONICAL_PHRASES), kind.phrases)
    wanted = np.concatenate([np.full(len(of_name), kind.others[0]), phrases, [kind.others[0]]])
    common = _with_cosines(unit(rng.normal(size=(1, vectors.shape[1]))), vectors, wanted)

    axes = np.linalg.qr(rng.normal(size=(vectors.shape[1], kind.dimensions)))[0]
    differing = unit(rng.normal(size=(count, kind.dimensions))) @ axes.T
    prototypes = np.sqrt(kind.common) * common + np.sqrt(1 - kind.common) * differing

    cosines = np.tile(wanted, (count, 1))
    cosines[:, : len(of_name)] = rng.normal(*kind.others, (count, len(of_name)))
    cosines[:, len(of_name) : -1] = rng.normal(kind.phrases, PHRASE_SPREAD, (count, len(phrases)))
    for column, numbers in enumerate(of_name.values()):
        cosines[list(numbers), column] = rng.normal(*kind.own, len(numbers))
    return _with_cosines(prototypes, vectors, cosines)


def _with_cosines(rows: Floats, vectors: Floats, wanted: Floats) -> Floats:
    """Return unit rows [n, D] whose products with vectors [words, D] are those wanted, [n, words], changed as little as
    possible."""
    back = np.linalg.pinv(vectors).T
    rows = unit(rows)
    for _ in range(50):
        rows = unit(rows + (wanted - rows @ vectors.T) @ back)
    return rows


def draw_hosts(
    object_maps: Iterable[NDArray[np.int64]],
    count: int,
    things: Collection[int],
    share: float,
    rng: np.random.Generator,
) -> NDArray[np.int64]:
    """Draw which things are swallowed: [count] the object whose region contains each object's pixels.

    A swallowed thing belongs to the larger neighbour with which it shares most of its border, over all views.

    ``object_maps``: true object of each pixel per view, [H, W].
    """
    areas, borders = np.zeros(count), np.zeros(count * count)
    for shown in object_maps:
        areas += np.bincount(shown.ravel(), minlength=count)
        for one, other in ((shown[1:], shown[:-1]), (shown[:, 1:], shown[:, :-1])):
            borders += np.bincount((one * count + other).ravel(), minlength=count * count)
    beside = borders.reshape(count, count) + borders.reshape(count, count).T
    swallowed = rng.permutation(sorted(things))[: round(share * len(things))]
    hosts = np.arange(count)
    for number in swallowed:
        possible = (areas > areas[number]) & ~np.isin(np.arange(count), swallowed)
        if (beside[number] * possible).any():
            hosts[number] = int((beside[number] * possible).argmax())
    return hosts
