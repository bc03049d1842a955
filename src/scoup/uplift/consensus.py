"""Consensus before coding: regions seen by the same Gaussians come to agree on their embeddings.

Source: the project's study of codes and votes ("consensus before coding", variant RS adaptive). It stands between the
region sums of one rasterisation pass and stage 1 of the method: the embeddings it gives are coded and uplifted as ever.

With A [N, R] the region sums of one level and z its row sums, M = A^T diag(1/z) A, rows scaled to sum 1, says what
share of what region r shows is shown by region s too. From G = F, the unit embeddings, three times

    G_r = unit(sum over s of M_rs exp(-kappa (1 - cos(F_s, G_r))) F_s),  kappa = 3 / median of 1 - cos(F_r, F_s)

A region is thus drawn to what those agree on that show the same thing: a wrong embedding is mended, and neighbours
that only share Gaussians at a border do not blend.

Cost, with P = sum over Gaussians of (regions that Gaussian i paints)^2 and E <= R * ``most`` the entries of M that are
kept: O(P) for M, O(rounds * E * D) for the rounds. Memory beyond A and F: 24 bytes a non-zero of A, 8 R * ``most``
bytes for M, 2 R D floats, and blocks whose size does not grow with the scene (some 200 MB). Neither an
R x R nor an N x D array is ever made. Everything runs on the CPU in one order, so that the same input gives the same
bits whatever the number of threads.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from scoup.base.errors import InputError
from scoup.base.progress import Progress, no_progress
from scoup.scene.directions import normalise_embeddings
from scoup.uplift.region_sums import RegionSums, Rows

if TYPE_CHECKING:
    from scipy.sparse import csr_array

STAGE = "consensus"  # of progress
SAMPLE = (
    2048  # regions whose pairs determine kappa; the median of their many pairs is that of all to about 1 %
)
LEAST_DISTANCE = (
    1e-4  # the least 1 - cos that counts as a difference; bounds kappa where all embeddings are equal
)
BLOCK_ENTRIES = 4_000_000  # of M before pruning, at a time
SCAN = 8_000_000  # non-zeros of A read together
REPORT_EVERY = 512  # regions between two reports

Step = Callable[[int], None]
"""``step(count)``: that many more regions are done."""


@dataclass(frozen=True)
class ConsensusSettings:
    """How regions agree.

    Attributes:
        rounds: how often the weights are found anew; 0 leaves the embeddings.
        strictness: kappa times the median distance of co-visible regions. 0 gives the plain mean (variant S of the
            study), which blurs small things into large ones.
        least: share of a region below which another counts as not co-visible.
        most: entries of a row of M that are kept, the largest; bounds the memory. It should exceed the number of
            views, each of which may show the same thing.
    """

    rounds: int = 3
    strictness: float = 3.0
    least: float = 1e-4
    most: int = 256

    def __post_init__(self) -> None:
        if self.rounds < 0 or self.most < 1:
            raise InputError(f"consensus needs rounds >= 0 and most >= 1, got {self.rounds} and {self.most}")
        if not 0 <= self.least < 1 or not 0 <= self.strictness < float("inf"):
            raise InputError(
                f"consensus needs 0 <= least < 1 and a finite strictness >= 0, "
                f"got {self.least} and {self.strictness}"
            )


DEFAULT = ConsensusSettings()


def consensus(
    sums: RegionSums,
    embeddings: Sequence[Tensor],
    rows: Rows | None = None,
    settings: ConsensusSettings = DEFAULT,
    progress: Progress = no_progress,
) -> list[Tensor]:
    """Embeddings that regions seen by the same Gaussians agree on, one level after the other.

    Only one level's matrices are in memory at a time. May be interrupted by an exception from ``progress``.

    Args:
        sums: from ``region_sums``.
        embeddings: per level, [R, D] in the order of ``Regions.embeddings``.
        rows: of each view in them; by default those that ``sums`` has.
        settings: see ``ConsensusSettings``.
        progress: called for the stage "consensus" in regions, each counted once for M and once a round.

    Returns:
        Per level, [R, D] float32 on the device of the input: see ``consensus_of``.

    Raises:
        InputError: levels or numbers of regions do not agree, or an embedding is not finite.
    """
    if len(embeddings) != len(sums.levels):
        raise InputError(f"there are {len(sums.levels)} levels, but embeddings of {len(embeddings)}")
    step = _counted(progress, sum(map(len, embeddings)) * (1 + settings.rounds))
    matrices = (sums.matrix(level, None if rows is None else rows[level]) for level in range(len(embeddings)))
    return [
        _consensus(matrix, of_level, settings, step)
        for matrix, of_level in zip(matrices, embeddings, strict=True)
    ]


def consensus_of(
    matrix: csr_array,
    rows: Tensor,  # [R, D]
    settings: ConsensusSettings = DEFAULT,
    progress: Progress = no_progress,
) -> Tensor:
    """The consensus of one level.

    Args:
        matrix: A [N, R], the region sums (``RegionSums.matrix``); not changed.
        rows: [R, D] floating-point embeddings of any norm.
        settings, progress: as in ``consensus``.

    Returns:
        [R, D] float32 unit rows on the device of ``rows``. Regions that no Gaussian painted keep their direction;
        embeddings of norm zero stay zero and reach no other.

    Raises:
        InputError: A and the embeddings are of different numbers of regions, or an embedding is not finite.
    """
    return _consensus(matrix, rows, settings, _counted(progress, len(rows) * (1 + settings.rounds)))


def covisible(
    matrix: csr_array, settings: ConsensusSettings = DEFAULT, progress: Progress = no_progress
) -> csr_array:
    """M [R, R] float32 CSR: M[r, s] is the share of what region r shows that region s shows too.

    Each row sums to 1 before pruning to shares of at least ``least``, and of those to the ``most`` largest (ties: the
    first), and is not scaled again. Columns are in order. Rows of regions that no Gaussian painted are empty.

    Args:
        matrix: A [N, R], the region sums of one level.
        settings: see ``ConsensusSettings``.
        progress: called for the stage "consensus" in regions.
    """
    from scipy.sparse import csr_array

    total = _shape(matrix)[1]
    step = _counted(progress, total)
    scaled, turned, order = _near_together(matrix)
    shares = _covisible(scaled, turned, order, settings, step)[0]
    indptr, indices, data = _arrays(shares)
    back = np.argsort(order)
    named = csr_array((data, order[indices].astype(np.int32), indptr), shape=(total, total))
    named = csr_array(named[back])
    named.sort_indices()
    return named


def _counted(progress: Progress, total: int) -> Step:
    done = 0

    def step(count: int) -> None:
        nonlocal done
        done += count
        progress(STAGE, done, total)

    step(0)
    return step


def _consensus(matrix: csr_array, rows: Tensor, settings: ConsensusSettings, step: Step) -> Tensor:
    unit = normalise_embeddings(rows).cpu()
    if _shape(matrix)[1] != len(unit):
        raise InputError(
            f"the region sums are of {_shape(matrix)[1]} regions, but there are {len(unit)} embeddings"
        )
    with _one_thread():
        scaled, turned, order = _near_together(matrix)
        unit = unit[torch.from_numpy(order)]
        shares, distance = _covisible(scaled, turned, order, settings, step, unit)
        del scaled, turned
        kappa = settings.strictness / max(distance, LEAST_DISTANCE)
        found = _agree(shares, unit, kappa, settings.rounds, step)
    agreed = torch.empty_like(found)
    agreed[torch.from_numpy(order)] = found
    return agreed.to(rows.device)


def _near_together(matrix: csr_array) -> tuple[csr_array, csr_array, NDArray[np.int64]]:
    """A diag(1/z)^(1/2), whose Gram matrix is M, and its transpose, with near things in near places.

    Gaussians are sorted by the first region that sees them, regions by the Gaussian in the middle of theirs: what
    shows one object stands together. Products and gathers then find in the cache what they need next, which made
    them about three times as fast at R = 60,000; nothing else depends on it.

    Returns:
        [N, R] and [R, N] float32 CSR of the sorted Gaussians and regions, and the regions [R] in their new order.
    """
    from scipy.sparse import csr_array

    count, total = _shape(matrix)
    indptr, indices, data = _arrays(matrix)
    z = np.asarray(matrix.sum(1, dtype=np.float64)).ravel()
    scale = (1.0 / np.sqrt(np.where(z > 0, z, 1.0))).astype(np.float32)
    painted = np.diff(indptr)
    first = np.full(count, total, np.int64)
    first[painted > 0] = indices[indptr[:-1][painted > 0]]
    by_region = np.argsort(first, kind="stable")
    whole = csr_array(
        (data.astype(np.float32, copy=False), indices.astype(np.int32, copy=False), _narrow(indptr)),
        shape=(count, total),
    )
    scaled = csr_array(whole[by_region])
    scaled.data *= np.repeat(scale[by_region], painted[by_region])
    turned = scaled.T.tocsr()
    ends, gaussians, _ = _arrays(turned)
    middle = np.full(total, count, np.int64)
    seen = np.diff(ends) > 0
    middle[seen] = gaussians[((ends[:-1] + ends[1:]) // 2)[seen]]
    order = np.argsort(middle, kind="stable")
    place = np.empty(total, np.int32)
    place[order] = np.arange(total, dtype=np.int32)
    scaled = csr_array((scaled.data, place[scaled.indices], scaled.indptr), shape=(count, total))
    return scaled, csr_array(turned[order]), order


def _covisible(
    scaled: csr_array,
    turned: csr_array,
    order: NDArray[np.int64],
    settings: ConsensusSettings,
    step: Step,
    unit: Tensor | None = None,
) -> tuple[csr_array, float]:
    """M of sorted regions, and the median distance of co-visible pairs if their unit embeddings [R, D] are given."""
    from scipy.sparse import csr_array

    count = len(order)
    sampled = np.zeros(count, bool)
    known = sampled if unit is None else unit.any(1).numpy()
    if unit is not None and count:
        sampled[np.linspace(0, count - 1, min(count, SAMPLE)).astype(np.int64)] = True
        sampled = sampled[order]
    distances: list[Tensor] = []
    most = min(settings.most, count)
    columns = np.empty(count * most, np.int32)  # pages that are not written to take no memory
    shares = np.empty(count * most, np.float32)
    ends = np.zeros(count + 1, np.int64)
    used = 0
    for first, block in _blocks_of_product(scaled, turned):
        indptr, indices, data = _arrays(block)
        for row in range(len(indptr) - 1):
            own = slice(indptr[row], indptr[row + 1])
            column, share = indices[own], data[own]
            if len(column):
                share = share / share.sum(dtype=np.float64)
                chosen = np.flatnonzero(share >= settings.least)
                column, share = column[chosen], share[chosen].astype(np.float32)
                if unit is not None and sampled[first + row]:
                    distances.append(_distances(unit, known, first + row, column))
                if len(column) > most:
                    chosen = _largest(order[column], share, most)
                    column, share = column[chosen], share[chosen]
                sorting = np.argsort(column)
                columns[used : used + len(column)] = column[sorting]
                shares[used : used + len(column)] = share[sorting]
            used += len(column)
            ends[first + row + 1] = used
        step(len(indptr) - 1)
    found = torch.cat(distances) if distances else torch.empty(0)
    middle = float(found.median()) if len(found) else 0.0
    return csr_array((shares[:used], columns[:used], _narrow(ends)), shape=(count, count)), middle


def _blocks_of_product(scaled: csr_array, turned: csr_array) -> Iterator[tuple[int, csr_array]]:
    """(first row, rows of turned @ scaled as CSR, columns in no order) from above.

    Whole rows, so that they can be pruned once and for all: blocks of Gaussians would have to be pruned before their
    sum is known.
    """
    from scipy.sparse import csr_array

    painted = np.diff(scaled.indptr)  # [N] regions each Gaussian paints
    sizes = np.minimum(_products(turned, painted), _shape(scaled)[1])  # bounds the non-zeros of each row of M
    first = 0
    while first < len(sizes):
        size, last = int(sizes[first]), first + 1
        while last < len(sizes) and size + sizes[last] <= BLOCK_ENTRIES:
            size += int(sizes[last])
            last += 1
        yield first, csr_array(turned[first:last] @ scaled)
        first = last


def _products(turned: csr_array, painted: NDArray[np.integer]) -> NDArray[np.int64]:
    """[R] multiplications that each row of M takes."""
    indptr, indices, _ = _arrays(turned)
    out = np.zeros(len(indptr) - 1, np.int64)
    first = 0
    while first < len(out):
        start = indptr[first]
        last = max(first + 1, int(np.searchsorted(indptr, start + SCAN, "right")) - 1)
        sums = np.zeros(indptr[last] - start + 1, np.int64)
        np.cumsum(painted[indices[start : indptr[last]]], out=sums[1:])
        out[first:last] = np.diff(sums[indptr[first : last + 1] - start])
        first = last
    return out


def _largest(columns: NDArray[np.int64], shares: NDArray[np.float32], most: int) -> NDArray[np.int64]:
    """Places of the ``most`` largest shares; of equal ones those with the first columns."""
    edge = np.partition(shares, len(shares) - most)[len(shares) - most]
    above = np.flatnonzero(shares > edge)
    level = np.flatnonzero(shares == edge)
    level = level[np.argsort(columns[level])][: most - len(above)]
    return np.concatenate([above, level])


def _distances(unit: Tensor, known: NDArray[np.bool_], row: int, columns: NDArray[np.int32]) -> Tensor:
    """1 - cos of a region and the others it is co-visible with; those without an embedding do not count."""
    if not unit[row].any():
        return torch.empty(0)
    others = columns[columns != row]
    others = others[known[others]]
    return 1 - unit.index_select(0, torch.from_numpy(others)).mv(unit[row])


def _agree(shares: csr_array, unit: Tensor, kappa: float, rounds: int, step: Step) -> Tensor:
    """The rounds: [R, D] unit rows."""
    agreed = unit.clone()
    indptr, indices, data = _arrays(shares)
    columns, weights, ends = torch.from_numpy(indices), torch.from_numpy(data), indptr.tolist()
    known = unit.any(1)
    is_known = known.tolist()
    all_known = all(is_known)
    since = 0
    # A region's rounds need no other region's result, so its neighbours are gathered once for all of them.
    for row in range(len(unit)):
        column, share = columns[ends[row] : ends[row + 1]], weights[ends[row] : ends[row + 1]]
        if not all_known:
            telling = known[column]
            column, share = column[telling], share[telling]
        if is_known[row] and rounds and len(column):
            others, mean = unit.index_select(0, column), unit[row]
            for _ in range(rounds):
                cosines = others.mv(mean)
                # A common factor of the weights cancels; measured from the nearest one they cannot vanish all.
                weight = cosines.sub_(cosines.max()).mul_(kappa).exp_().mul_(share)
                mean = weight[None].mm(others)[0]
                mean /= mean.norm()
            agreed[row] = mean
        since += 1
        if since == REPORT_EVERY or row + 1 == len(unit):
            step(since * rounds)
            since = 0
    return agreed


def _shape(matrix: csr_array) -> tuple[int, int]:
    return cast("tuple[int, int]", matrix.shape)


def _arrays(matrix: csr_array) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """indptr, indices, data."""
    return np.asarray(matrix.indptr), np.asarray(matrix.indices), np.asarray(matrix.data)


def _narrow(indices: NDArray[np.integer]) -> NDArray[np.integer]:
    """As int32 where they fit: scipy's products run faster and the index arrays must be of one type."""
    return indices.astype(np.int32 if indices[-1] <= np.iinfo(np.int32).max else np.int64)


@contextmanager
def _one_thread() -> Iterator[None]:
    """torch sums in an order that depends on its number of threads."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
