"""The vote: region sums and the codes of the regions to one code a Gaussian (method.md, stage 2).

It goes bucket by bucket of Gaussians through all views, so that what is summed up, [N, S, L] numbers, is never in
memory as a whole. The order of all additions is fixed: the same bytes for any number of threads.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from scoup.base.backends import load_backend
from scoup.base.counts import spread
from scoup.base.errors import InputError
from scoup.base.progress import Progress, no_progress
from scoup.raster import restored
from scoup.scene.codes import SparseCodes, index_dtype, stable_products
from scoup.uplift.region_sums import RegionSums
from scoup.uplift.reweighting import SAMPLED_VIEWS, EarlierRound, sharpness_from
from scoup.uplift.storage.entries import BUCKET, Entries

BATCHES = 16  # between which progress is reported and memory of a file is given back
BACKENDS = {
    "native": "scoup.uplift.vote_backends.native",
    "reference": "scoup.uplift.vote_backends.reference",
    "triton": "scoup.uplift.vote_backends.triton",
}


@dataclass(frozen=True, eq=False)
class VotedEntries:
    """Entries of a view, and the rows of the codes that its combinations stand for.

    Attributes:
        entries: see there.
        regions: [C, S] int64, row of the region at each level among those of all views; -1 for none.
    """

    entries: Entries
    regions: NDArray[np.int64]


class VoteBackend(Protocol):
    """Sums and codes, ready to be added up. The class ``Vote`` of each module in ``BACKENDS``, made with
    (n_gaussians, views, codes, grams, device).
    """

    def round(
        self, keep: int, earlier: EarlierRound | None, unit_norm: bool, buckets: range
    ) -> tuple[Tensor, Tensor]:
        """The ``keep`` largest of w_i = sum over regions of A[i, r] W_r, for the Gaussians of some buckets.

        Args:
            keep: atoms kept of each Gaussian and level.
            earlier: the round before, by which regions count; None counts them by A alone. Of all Gaussians.
            unit_norm: scale weights so that a decoded code has norm 1, instead of to sum 1.
            buckets: one after another.

        Returns:
            indices [n, S, keep] uint8 (uint16 beyond 256 atoms), weights [n, S, keep] float32; on the CPU.
        """
        ...

    def deviations(self, earlier: EarlierRound, buckets: range) -> list[Tensor]:
        """Per level: 1 - cosine of each region and each Gaussian of some buckets that meet in a view."""
        ...


@dataclass(frozen=True, eq=False)
class GaussianCodes:
    """What a vote has found; Gaussians as in the scene.

    Attributes:
        indices: [N, S, K] uint8 (uint16 beyond 256 atoms).
        weights: [N, S, K] float32, largest first, summing to 1; zeros where no region was seen.
        sharpness: [S] float32, how strictly regions were held to the first round; None after a single round.
    """

    indices: Tensor
    weights: Tensor
    sharpness: Tensor | None = None


def vote(
    sums: RegionSums,
    codes: Sequence[SparseCodes],
    codebook: Tensor | ArrayLike,  # [S, L, D]
    rounds: int = 1,
    keep: int | None = 4,
    keep_between: int | None = None,
    backend: str | None = None,
    progress: Progress = no_progress,
) -> GaussianCodes:
    """The code of every Gaussian: the ``keep`` largest entries of w_i = sum of A[i, r] W_r, scaled to sum 1.

    In the first round all regions count by their blending weights alone (method.md, stage 2); see
    ``scoup.uplift.reweighting`` for the others. The work is done on the device of the codebook.

    Args:
        sums: of the views that vote, with the rows of their regions among the codes (``RegionSums.of_views``).
        codes: per level, of the regions of all views.
        codebook: [S, L, D] float32; only its inner products are used, and only after the first round.
        rounds: 1 or more.
        keep: atoms of a Gaussian; None keeps all.
        keep_between: atoms of a Gaussian that a round hands to the next; by default ``keep``, or the codes' own K.
        backend: "native", "reference" or "triton"; by default what suits the device.
        progress: called for the stage "vote".

    Returns:
        Codes on the CPU.

    Raises:
        InputError: a view has no sums or a region no code, numbers make no sense, or the backend cannot be used.

    Example:
        >>> gaussians, cameras = scoup.load_gaussians("scene/point_cloud.ply"), scoup.load_cameras("scene")
        >>> regions = scoup.load_regions("scene", cameras)
        >>> sums = scoup.region_sums(gaussians, cameras, regions)
        >>> books = [scoup.fit_codes(regions.embeddings(level)[0], n_atoms=8) for level in regions.levels]
        >>> codes = scoup.vote(sums, [book.codes for book in books], torch.stack([book.atoms for book in books]))
        >>> codes.indices.shape[:2] == (len(gaussians), 3)
        True
    """
    _check_numbers(rounds, keep)
    codebook = torch.as_tensor(codebook)
    _check_codes(sums, codes, codebook)
    grams = torch.stack([stable_products(atoms, atoms) for atoms in codebook.float().cpu()])
    views = _views_of(sums)
    module = load_backend(BACKENDS, codebook.device, backend, "vote")[1]

    def prepare(names: Sequence[str]) -> VoteBackend:
        parts = [part for name in names for part in views[name]]
        return module.Vote(sums.n_gaussians, parts, codes, grams, codebook.device)

    everybody, batches = prepare(list(views)), _batches(sums.n_buckets)
    done, total = 0, rounds * len(batches)

    def one_round(kept: int, earlier: EarlierRound | None, last: bool) -> tuple[Tensor, Tensor]:
        nonlocal done
        shape = (sums.n_gaussians, len(codes), kept)
        indices, weights = torch.empty(shape, dtype=index_dtype(codes[0].n_atoms)), torch.empty(shape)
        for batch in batches:
            progress("vote", done, total)
            rows = slice(batch.start * BUCKET, batch.stop * BUCKET)
            indices[rows], weights[rows] = everybody.round(kept, earlier, not last, batch)
            done += 1
        return indices, weights

    earlier = None
    for _ in range(1, rounds):
        indices, weights = one_round(keep_between or keep or codes[0].k, earlier, last=False)
        if earlier is None:
            earlier = EarlierRound(indices, weights, torch.zeros(len(codes)))
            sample = prepare(spread(list(views), SAMPLED_VIEWS))
            deviations = sample.deviations(earlier, range(sums.n_buckets))
            earlier = replace(earlier, sharpness=sharpness_from(deviations))
        earlier = replace(earlier, indices=indices, weights=weights)
    indices, weights = one_round(codes[0].n_atoms if keep is None else keep, earlier, last=True)
    progress("vote", done, total)
    return GaussianCodes(
        restored(indices, sums.order),
        restored(weights, sums.order),
        None if earlier is None else earlier.sharpness,
    )


def _views_of(sums: RegionSums) -> dict[str, list[VotedEntries]]:
    """The entries of each view that has rows, in the order of these."""
    assert sums.rows is not None
    views = {}
    for name in sums.rows[0]:
        firsts = np.array([of_level[name].start for of_level in sums.rows], np.int64)
        views[name] = [
            VotedEntries(part, np.where(part.table >= 0, part.table + firsts, -1))
            for part in sums.views[name].parts
        ]
    return views


def _batches(n_buckets: int) -> list[range]:
    buckets = range(n_buckets)
    size = -(-n_buckets // BATCHES) or 1
    return [buckets[first : first + size] for first in range(0, n_buckets, size)] or [buckets]


def _check_numbers(rounds: int, keep: int | None) -> None:
    if rounds < 1:
        raise InputError(f"the vote takes at least one round, not {rounds}")
    if keep is not None and keep < 1:
        raise InputError(f"the vote keeps at least one atom, not {keep}; None keeps all")


def _check_codes(sums: RegionSums, codes: Sequence[SparseCodes], codebook: Tensor) -> None:
    rows = sums.rows
    if rows is None:
        raise InputError("the rows of each view among the codes are not known (RegionSums.of_views)")
    if not len(codes) == len(codebook) == len(rows) == len(sums.levels) or any(
        level.n_atoms != codebook.shape[1] for level in codes
    ):
        raise InputError(
            f"{len(codes)} levels of codes and a codebook {list(codebook.shape)} do not fit sums of the levels "
            f"{list(sums.levels)}"
        )
    index_dtype(codes[0].n_atoms)
    for name in rows[0]:
        for level, (of_level, highest) in enumerate(zip(rows, sums.n_regions(name), strict=True)):
            if highest > len(range(*of_level[name].indices(len(codes[level])))):
                raise InputError(
                    f"{name!r}, level {sums.levels[level]!r}: the label maps have {highest} regions, but there are "
                    f"codes of {of_level[name].stop - of_level[name].start}; the embeddings are of other regions"
                )
