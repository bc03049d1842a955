"""Rounds of the vote: between two of them, what the last one found becomes what regions must agree with."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import torch
from torch import Tensor

from scoup.agreement import Agreement
from scoup.codes import SparseCodes
from scoup.uplifting import RegionSums, ViewSums, top_k, uplift

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
    accumulators = uplift(sums, codes)
    sharpness = None
    for _ in range(1, rounds):
        agreement = outcome(accumulators, codebook, keep, sharpness)
        if sharpness is None:
            rows = sums.rows

            def of_view(name: str, rows: Sequence[dict[str, slice]] = rows) -> list[SparseCodes]:
                return [level.rows(of_level[name]) for level, of_level in zip(codes, rows, strict=True)]

            sharpness = sharpness_of(agreement, spread(sums.views), of_view)
            agreement = agreement.with_sharpness(sharpness)
        accumulators = uplift(sums, codes, agreement)
    return accumulators


def outcome(accumulators: Tensor, codebook: Tensor, keep: int, sharpness: Tensor | None = None) -> Agreement:
    """What a round has found: the vote of ``keep`` atoms over accumulators [N, S, L]; codebook [S, L, D].

    ``sharpness`` [S] is zero, and all regions count alike, until it is known.
    """
    indices, weights = top_k(accumulators, keep)
    if sharpness is None:
        sharpness = torch.zeros(accumulators.shape[1])
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
            gaussian, region, _ = view.level(level)
            deviations[level].append(
                1 - agreement.cosines(level, gaussian, region, table.to(gaussian.device))
            )
    found = [torch.cat(of_level) for of_level in deviations]
    medians = [of_level.median() if len(of_level) else torch.tensor(1.0) for of_level in found]
    return SHARPNESS / torch.stack(medians).float().clamp(min=LEAST_DEVIATION)
