"""Presence: whether the thing is there at all, so that a query for something absent can return nothing.

The protocols rescale relevancy over the view before they cut it, so that every query gets a mask. The relevancy of the
mask says little, as some places are near to any word. The z-score compares the query with other words *there*: the
embedding of what was found has a cosine with the query and with each of many everyday words, and

    z = 1.645 + (cosine with the query - 95 % quantile of those with everyday words) / their standard deviation,

which for normally distributed cosines is the number of standard deviations of the query above the mean word. The
quantile asks more: where many words fit as well, what was found is rather one of those. Unlike the best word, it does
not depend on the size of the table. Other names of the query do not count (``other_words``). Fewer than
``LEAST_GAUSSIANS`` Gaussians in the scene count as nothing found. A least number of views needs no rule here: regions
of two views or more make a thing (``scoup.uplift.things``).

In a field with things, the score of the best thing is added (``scoup.query.things.ThingFits.presence``).

The query counts as present from a score of 1.4 on. This is ours; neither the paper nor the protocols judge presence.
Measured in docs/answers.md.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import torch
from torch import Tensor

from scoup import raster
from scoup.base.counts import counted
from scoup.base.errors import InputError
from scoup.models.words import LEAST_WORDS
from scoup.query.coded_scene import CodedScene
from scoup.query.segment import Segmentation
from scoup.query.select import Selection, true_rows
from scoup.query.text_vectors import TextVectors
from scoup.scene.codes import signed

PRESENT_FROM = 1.4
"""The default z-score from which a query counts as present."""
UPPER, NORMAL = 0.95, 1.645
"""The quantile of everyday words that a query is compared with, and its z-score in a normal distribution."""
SIMILAR, SAME = 3.0, 0.99
"""A word is another name of a query from so many standard deviations of words above their mean, and the query itself
from this cosine."""
LEAST_GAUSSIANS = 10
"""Fewer are a stray, not a thing."""
_AT_A_TIME = 8  # masks in one pass over a view


def presence_threshold(texts: TextVectors, wanted: float | None = None) -> float | None:
    """Return the z-score from which a text counts as present; None with too few everyday words to judge it."""
    if wanted is not None and not math.isfinite(wanted):
        raise InputError(f"the z-score from which a text counts as present must be a number, got {wanted}")
    if texts.can_judge_presence:
        return PRESENT_FROM if wanted is None else wanted
    if wanted is not None:
        raise InputError(
            f"{texts.source}: has {counted(len(texts.everyday), 'word')}, but presence is judged against {LEAST_WORDS} "
            "or more; add any words to the table"
        )
    return None


def other_words(queries: Tensor, words: Tensor) -> Tensor:
    """Return the words [B, D] that queries [Q, D] are compared with, [Q, B] boolean: all but other names of the query.

    Vectors have unit norm.
    """
    near = queries @ words.T
    alike = near > near.mean(1, keepdim=True) + SIMILAR * near.std(1, keepdim=True)
    return ~alike & (near < SAME)


def word_leads(own: Tensor, to_words: Tensor, others: Tensor) -> Tensor:
    """Return the lead of queries over the ``UPPER`` quantile of other words, in standard deviations of their cosines.

    Args:
        own: [Q] cosines of what was found with the queries.
        to_words: [Q, B] cosines with everyday words.
        others: [Q, B] boolean, from ``other_words``.

    Returns:
        [Q] float64; minus infinity where fewer than two words count.
    """
    own, to_words = own.double(), to_words.double()
    count = others.sum(1)
    ordered = torch.where(others, to_words, torch.inf).sort(1).values
    rank = (UPPER * count).ceil().long().clamp(min=1) - 1
    upper = ordered.gather(1, rank[:, None])[:, 0]
    mean = (to_words * others).sum(1) / count
    deviation = ((to_words - mean[:, None]).square() * others).sum(1).div(count).sqrt()
    return torch.where(count > 1, (own - upper) / deviation.clamp(min=1e-6), -torch.inf)


def z_scores(embeddings: Tensor, queries: Tensor, words: Tensor) -> Tensor:
    """Return the z-score of each query.

    Args:
        embeddings: [Q, D] of what was found for each query; of any length, zero if nothing was found.
        queries: [Q, D] unit vectors.
        words: [B, D] unit vectors of everyday words.

    Returns:
        [Q] float32 on the CPU; minus infinity where nothing was found.
    """
    if embeddings.shape != queries.shape or words.dim() != 2 or words.shape[1:] != queries.shape[1:]:
        raise InputError(
            f"embeddings {list(embeddings.shape)}, queries {list(queries.shape)} and words {list(words.shape)} "
            "do not fit together; expected [Q, D], [Q, D] and [B, D]"
        )
    if len(words) < LEAST_WORDS:
        raise InputError(f"presence is judged against {LEAST_WORDS} everyday words or more, got {len(words)}")
    found, wanted, everyday = (
        torch.nn.functional.normalize(each.double().cpu(), dim=1) for each in (embeddings, queries, words)
    )
    own, to_words = (found * wanted).sum(1), found @ everyday.T
    scores = NORMAL + word_leads(own, to_words, other_words(wanted, everyday))
    return torch.where(embeddings.cpu().any(1), scores, -torch.inf).float()


def with_evidence(z_score: float, selected: Tensor) -> float:
    """Return a score in the scene, minus infinity where fewer than ``LEAST_GAUSSIANS`` are selected [N]."""
    return z_score if int(selected.sum()) >= LEAST_GAUSSIANS else -math.inf


def view_z_scores(
    field: CodedScene,
    projection: raster.Projection,
    segmentations: Sequence[Segmentation],
    queries: Tensor,
    words: Tensor,
) -> Tensor:
    """Return the z-scores [Q] of the Gaussians that contribute to the more relevant half of each mask in a view."""
    embeddings = torch.zeros(len(segmentations), field.dim)
    for start in range(0, len(segmentations), _AT_A_TIME):
        part = segmentations[start : start + _AT_A_TIME]
        labels = torch.stack([each.core().int() - 1 for each in part])
        sums = raster.region_sums(projection, labels)
        for number, each in enumerate(part):
            gaussian, _, weight = sums.triplets(number)
            embeddings[start + number] = mean_embedding(field, each.level, gaussian, weight)
    return z_scores(embeddings, queries, words)


def scene_z_scores(
    field: CodedScene, selections: Iterable[Selection], queries: Tensor, words: Tensor
) -> Tensor:
    """Return the z-scores [Q] of the more relevant half of the Gaussians that each query selects."""
    embeddings = torch.zeros(len(queries), field.dim)
    for row, found in enumerate(selections):
        selected = true_rows(found.mask)
        if len(selected):
            relevancy = found.relevancy[selected]
            core = selected[relevancy >= relevancy.median()]
            embeddings[row] = mean_embedding(field, found.level, core, field.gaussians.opacities[core])
    return z_scores(embeddings, queries, words)


def mean_embedding(field: CodedScene, level: int, gaussians: Tensor, weights: Tensor) -> Tensor:
    """Return the sum of the decoded codes of Gaussians [M] by weights [M] at one level, [D] on the CPU."""
    # On the CPU: sums by index on a GPU are not the same twice.
    own = signed(field.code_indices)[:, level].index_select(0, gaussians)
    atoms = own.view(field.code_indices.dtype).cpu().long()
    shares = (field.code_weights[:, level].index_select(0, gaussians).float() * weights[:, None]).cpu()
    code = torch.bincount(atoms.flatten(), shares.flatten().double(), field.n_atoms)
    return code.float() @ field.codebook[level].cpu()
