"""Rounds of the vote: between two of them, what the last one found becomes what regions must agree with."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import torch
from torch import Tensor

from scoup.agreement import Agreement
from scoup.codes import SparseCodes
from scoup.uplifting import RegionSums, ViewSums, codes_of_view, top_k, uplift

SHARPNESS = 3.0  # times the inverse of the usual deviation
LEAST_DEVIATION = 1e-3  # 1 - cosine; identical regions would make it infinite
SAMPLED_VIEWS = 8


def accumulate(
    sums: RegionSums, codes: Sequence[SparseCodes], codebook: Tensor, rounds: int = 1, keep: int = 4
) -> Tensor:
    """Accumulators after some rounds of the vote.

    In the first round all regions count by their blending weights alone (method.md, stage 2). Each later round adds up
    the same regions anew, each weighed by its agreement with what the round before has found (``Agreement``).

    Args:
        sums: from ``region_sums``.
        codes: per level, of all regions.
        codebook: [S, L, D] float32.
        rounds: 1 or more.
        keep: atoms of a Gaussian that a round hands on to the next.

    Returns:
        [N, S, L] float32.
    """
    agreement = None
    accumulators = uplift(sums, codes)
    for _ in range(1, rounds):
        agreement = next_agreement(
            accumulators,
            codebook,
            keep,
            agreement,
            lambda: spread(sums.views),
            lambda name: codes_of_view(codes, sums.rows, name),
        )
        accumulators = uplift(sums, codes, agreement)
    return accumulators


def next_agreement(
    accumulators: Tensor,
    codebook: Tensor,
    keep: int,
    previous: Agreement | None,
    sample: Callable[[], Iterable[ViewSums]],
    codes_of: Callable[[str], list[SparseCodes]],
) -> Agreement:
    """What a round has found, as the yardstick of the next.

    The sharpness is learned after the first round and kept.

    Args:
        accumulators: [N, S, L] of the round.
        codebook: [S, L, D].
        keep: atoms of a Gaussian that are handed on.
        previous: what this round was held to; None after the first.
        sample: makes the region sums of some views; called after the first round only.
        codes_of: per level, the codes of a view's regions, by the name of the view.
    """
    if previous is not None:
        return outcome(accumulators, codebook, keep, previous.sharpness)
    agreement = outcome(accumulators, codebook, keep, torch.zeros(accumulators.shape[1]))
    return agreement.with_sharpness(sharpness_of(agreement, sample(), codes_of))


def outcome(accumulators: Tensor, codebook: Tensor, keep: int, sharpness: Tensor) -> Agreement:
    """The vote of ``keep`` atoms over accumulators [N, S, L]; codebook [S, L, D], sharpness [S]."""
    indices, weights = top_k(accumulators, keep)
    return Agreement.with_codes(indices, weights, codebook.to(accumulators.device), sharpness)


def spread(views: Sequence) -> list:
    """At most ``SAMPLED_VIEWS`` of the views, evenly spread."""
    count = min(SAMPLED_VIEWS, len(views))
    return [views[(2 * i + 1) * len(views) // (2 * count)] for i in range(count)]


def sharpness_of(
    agreement: Agreement, views: Iterable[ViewSums], codes_of: Callable[[str], list[SparseCodes]]
) -> Tensor:
    """[S] float32: ``SHARPNESS`` over the median deviation 1 - cosine of regions from the Gaussians they paint.

    So a region that deviates as usual counts exp(-3), and what is usual is learned from the scene itself: noisy
    embeddings are held to less strictly.

    Args:
        agreement: what has been found.
        views: region sums of some views, with the agreement's Gaussians.
        codes_of: per level, the codes of a view's regions, by the name of the view.
    """
    n_levels = agreement.indices.shape[1]
    deviations: list[list[Tensor]] = [[] for _ in range(n_levels)]
    for view in views:
        tables = agreement.region_cosines(codes_of(view.view_name))
        for level, table in enumerate(tables):
            gaussian, region, _ = (part.to(table.device) for part in view.level(level))
            deviations[level].append(1 - agreement.cosines(level, gaussian, region, table))
    found = [torch.cat(of_level) for of_level in deviations]
    medians = [of_level.median() if len(of_level) else of_level.new_ones(()) for of_level in found]
    return SHARPNESS / torch.stack(medians).float().clamp(min=LEAST_DEVIATION)
