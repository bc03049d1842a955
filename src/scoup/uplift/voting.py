"""The vote: region sums and the codes of the regions become one code per Gaussian (method.md, stage 2).

It goes bucket by bucket of Gaussians through all views, so that the [N, S, L] sums are never in memory as a whole. The
order of all additions is fixed: the same bytes for any number of threads.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from scoup.base import InputError, Progress, load_backend, no_progress, spread
from scoup.raster import restored
from scoup.scene import SparseCodes, index_dtype, signed, stable_products
from scoup.uplift import constants
from scoup.uplift.reweighting import EarlierRound, scene_sharpness
from scoup.uplift.storage.entries import BUCKET, Entries
from scoup.uplift.stored_sums import RegionSums

if TYPE_CHECKING:
    from scoup.uplift.vote_backends import native, reference

BATCHES = 16  # on a CPU
# Modules with a class ``Vote``; the reference documents it.
BACKENDS = {
    "native": "scoup.uplift.vote_backends.native",
    "reference": "scoup.uplift.vote_backends.reference",
    "triton": "scoup.uplift.vote_backends.triton",
}


@dataclass(frozen=True, eq=False)
class CodedEntries:
    """Entries of a view, and the rows of their regions among the codes of all views."""

    entries: Entries
    regions: NDArray[np.int64]  # [C, S] per label tuple, -1 for none


@dataclass(eq=False)
class PreparedVote:
    """What the ``Vote`` of every backend is made of."""

    n_gaussians: int
    views: Sequence[CodedEntries]
    codes: Sequence[SparseCodes]  # per level, of the regions of all views
    grams: Tensor  # [S, L, L] inner products of the atoms
    device: torch.device

    def __post_init__(self) -> None:
        """Check it, and bring it to the backend's form."""


@dataclass(frozen=True, eq=False)
class GaussianCodes:
    """The outcome of a vote; Gaussians in the order of the scene."""

    indices: Tensor  # [N, S, K] uint8 (uint16 beyond 256 atoms)
    weights: Tensor  # [N, S, K] float32, largest first, summing to 1; zeros where no region was seen
    sharpness: Tensor | None = None  # [S] float32, of the rounds after the first; None after a single round


def vote(
    sums: RegionSums,
    codes: Sequence[SparseCodes],
    codebook: Tensor | ArrayLike,
    rounds: int = 1,
    keep: int | None = 4,
    backend: str | None = None,
    progress: Progress = no_progress,
) -> GaussianCodes:
    """Return the code of every Gaussian: the ``keep`` largest of w_i = sum of A[i, r] W_r, scaled to sum 1.

    In the first round regions count by their blending weights alone (method.md, stage 2); see
    ``scoup.uplift.reweighting`` for the others. Runs on the device of the codebook.

    Args:
        sums: of the views that vote, with the rows of their regions among the codes (``RegionSums.select``).
        codes: per level, of the regions of all views.
        codebook: [S, L, D] float32; only its inner products are used, and only after the first round.
        rounds: 1 or more.
        keep: atoms per Gaussian; None keeps all, and as many as the codes have between rounds.
        backend: "native", "reference" or "triton"; by default the fastest for the device.
        progress: called for the stage "vote".

    Returns:
        Codes on that device.

    Raises:
        InputError: a view has no sums or a region no code, a number is out of range, or the backend cannot be used.

    Example:
        >>> gaussians, cameras = scoup.load_gaussians("scene/point_cloud.ply"), scoup.load_cameras("scene")
        >>> regions = scoup.load_regions("scene", cameras)
        >>> sums = scoup.region_sums(gaussians, cameras, regions)
        >>> books = [scoup.fit_codes(regions.embeddings(level)[0], n_atoms=8) for level in regions.levels]
        >>> codes = scoup.vote(sums, [book.codes for book in books], torch.stack([book.atoms for book in books]))
        >>> codes.indices.shape[:2] == (len(gaussians), 3)
        True
    """
    if rounds < 1:
        raise InputError(f"the vote needs at least one round, got {rounds}")
    if keep is not None and keep < 1:
        raise InputError(f"the vote must keep at least one atom, got {keep}; None keeps all")
    codebook = torch.as_tensor(codebook)
    _check_codes(sums, codes, codebook)
    grams = torch.stack([stable_products(atoms, atoms) for atoms in codebook.float().cpu()])
    views = _coded_entries(sums)
    module = load_backend(BACKENDS, codebook.device, backend, "vote")[1]

    def prepare(names: Sequence[str]) -> reference.Vote | native.Vote:
        parts = [entries for name in names for entries in views[name]]
        return module.Vote(sums.n_gaussians, parts, codes, grams, codebook.device)

    all_views = prepare(list(views))
    batches = _batches(sums.n_buckets, all_views.batches)
    done, total = 0, rounds * len(batches)

    def one_round(count: int, earlier: EarlierRound | None, last: bool) -> tuple[Tensor, Tensor]:
        nonlocal done
        shape, device = (sums.n_gaussians, len(codes), count), codebook.device
        indices = torch.empty(shape, dtype=index_dtype(codes[0].n_atoms), device=device)
        weights = torch.empty(shape, device=device)
        for batch in batches:
            progress("vote", done, total)
            rows = slice(batch.start * BUCKET, batch.stop * BUCKET)
            some, weights[rows] = all_views.round(count, earlier, not last, batch)
            signed(indices)[rows] = signed(some)
            done += 1
        return indices, weights

    earlier = None
    for _ in range(1, rounds):
        indices, weights = one_round(keep or codes[0].k, earlier, last=False)
        if earlier is None:
            earlier = EarlierRound(indices, weights, torch.zeros(len(codes)))
            sample = prepare(spread(list(views), constants.SAMPLED_VIEWS))
            deviations = sample.deviations(earlier, range(sums.n_buckets))
            earlier = replace(earlier, sharpness=scene_sharpness(deviations))
        earlier = replace(earlier, indices=indices, weights=weights)
    indices, weights = one_round(codes[0].n_atoms if keep is None else keep, earlier, last=True)
    progress("vote", done, total)
    return GaussianCodes(
        restored(indices, sums.order.to(indices.device)),
        restored(weights, sums.order.to(weights.device)),
        None if earlier is None else earlier.sharpness,
    )


def _coded_entries(sums: RegionSums) -> dict[str, list[CodedEntries]]:
    """Return the parts of each view that has rows, in the order of the rows."""
    assert sums.rows is not None
    views = {}
    for name in sums.rows[0]:
        firsts = np.array([of_level[name].start for of_level in sums.rows], np.int64)
        views[name] = [
            CodedEntries(entries, np.where(entries.table >= 0, entries.table + firsts, -1))
            for entries in sums.views[name].parts
        ]
    return views


def _batches(n_buckets: int, count: int) -> list[range]:
    buckets = range(n_buckets)
    size = -(-n_buckets // count) or 1
    return [buckets[first : first + size] for first in range(0, n_buckets, size)] or [buckets]


def _check_codes(sums: RegionSums, codes: Sequence[SparseCodes], codebook: Tensor) -> None:
    rows = sums.rows
    if rows is None:
        raise InputError("the rows of each view among the codes are not known; use RegionSums.select")
    if not len(codes) == len(codebook) == len(rows) == len(sums.levels) or any(
        level.n_atoms != codebook.shape[1] for level in codes
    ):
        raise InputError(
            f"{len(codes)} levels of codes and a codebook {list(codebook.shape)} do not fit sums of the levels "
            f"{list(sums.levels)}"
        )
    index_dtype(codes[0].n_atoms)  # refuses codebooks that are too large
    for name in rows[0]:
        for level, (of_level, highest) in enumerate(zip(rows, sums.n_regions(name), strict=True)):
            if highest > len(range(*of_level[name].indices(len(codes[level])))):
                raise InputError(
                    f"{name!r}, level {sums.levels[level]!r}: the label maps have {highest} regions, but there are "
                    f"codes of {of_level[name].stop - of_level[name].start}; the embeddings are of other regions"
                )
