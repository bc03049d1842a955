"""Region sums of a projection, on a GPU."""

# A launch takes plain numbers as constants, and options beside the kernel's arguments.
# pyright: reportArgumentType=false, reportCallIssue=false

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import torch
import triton
from torch import Tensor

from scoup.raster.triton.kernels.regions import (
    columns_kernel,
    gather_kernel,
    region_sums_kernel,
    unpack_kernel,
)
from scoup.raster.triton.projection import FUSED, TILE, TritonProjection

MOST_SUMS = 1 << 27  # entries that there is room for at a time: two gigabytes at the most
CHUNK = 32
COLUMNS = 16
WARPS = 2  # of a program that sums up: a thread per pixel
_BLOCK = 256


@dataclass(frozen=True, eq=False)
class Columns:
    """The pixels of each tile by their combination of regions: a column is a combination that some pixel has."""

    of_pixel: Tensor  # [tiles, P] int16, the column of each pixel of a tile, -1 without any region
    combinations: Tensor  # [tiles, P] int32, of each column
    counts: Tensor  # [tiles] int32
    room: Tensor  # [tiles] int64, columns times Gaussians of each tile


def region_sums(
    projection: TritonProjection, combinations: Tensor, n_combinations: int
) -> tuple[Tensor, Tensor, Tensor]:
    """See ``raster.region_sums``; ``combinations`` is the map [H, W] of ``CombinedLabels``."""
    n_combinations = max(1, n_combinations)
    small = projection.n_gaussians * n_combinations < 2**31  # sorted in half the passes
    dtype = torch.int32 if small else torch.int64
    columns = columns_of(projection, combinations)
    # A pixel has weights of 1 at the most, and they are known to 2^-40 (``halves_of_weights``).
    scale = 2.0 ** min(40, 62 - combinations.numel().bit_length())
    ends = torch.cumsum(columns.room, 0)
    entries = [
        _entries_of(projection, columns, ends, n_combinations, scale, lot, dtype)
        for lot in lots(ends, int(ends[-1]))
    ]
    if not any(len(keys) for keys, _ in entries):
        none = torch.zeros(0, dtype=torch.int32, device=projection.device)
        return none, none, none.float()
    keys, weights = (torch.cat(parts) for parts in zip(*entries, strict=True))
    return _merge(keys, weights, n_combinations, scale)


def columns_of(projection: TritonProjection, combinations: Tensor) -> Columns:
    """See ``Columns``; combinations [H, W] int32."""
    shape, device = (projection.n_tiles, TILE * TILE), projection.device
    columns = Columns(
        torch.empty(shape, dtype=torch.int16, device=device),
        torch.empty(shape, dtype=torch.int32, device=device),
        torch.empty(projection.n_tiles, dtype=torch.int32, device=device),
        torch.empty(projection.n_tiles, dtype=torch.int64, device=device),
    )
    columns_kernel[(projection.n_tiles,)](
        combinations.contiguous(), projection.starts, columns.of_pixel, columns.combinations, columns.counts,
        columns.room, projection.width, projection.height, projection.across, TILE=TILE, **FUSED,
    )  # fmt: skip
    return columns


@dataclass(frozen=True)
class Lot:
    """Some tiles that follow each other, for whose entries there is room at a time."""

    tiles: range
    before: int  # room for the tiles before
    room: int


def lots(ends: Tensor, total: int) -> Iterator[Lot]:
    """Yield all tiles with Gaussians and regions, as many at a time as ``MOST_SUMS`` allows; ``ends`` [tiles] is where
    the room for each ends, ``total`` the last of them.
    """
    if total <= MOST_SUMS:
        if total:
            yield Lot(range(len(ends)), 0, total)
        return
    ends = ends.cpu()
    first, before = 0, 0
    while before < total:
        last = int(torch.searchsorted(ends, before + MOST_SUMS, right=True))
        last = max(last, first + 1)
        behind = int(ends[last - 1])
        if behind > before:
            yield Lot(range(first, last), before, behind - before)
        first, before = last, behind


def _entries_of(
    projection: TritonProjection,
    columns: Columns,
    ends: Tensor,
    n_combinations: int,
    scale: float,
    lot: Lot,
    dtype: torch.dtype,
) -> tuple[Tensor, Tensor]:
    """Return keys and weights of the entries of a lot, tile after tile."""
    device, grid, preset = projection.device, (len(lot.tiles),), projection.preset
    types = dtype, torch.int64
    roomy = [torch.empty(lot.room, dtype=kind, device=device) for kind in types]
    counts = torch.empty(len(lot.tiles), dtype=torch.int32, device=device)
    region_sums_kernel[grid](
        projection.records, projection.numbers, projection.starts, columns.of_pixel, columns.combinations,
        columns.counts, ends, *roomy, counts, projection.width, projection.height, projection.across,
        lot.tiles.start, lot.before, n_combinations, scale, preset.alpha_max, preset.stop,
        STOP_INCLUSIVE=preset.stop_inclusive, TILE=TILE, CHUNK=CHUNK, COLUMNS=COLUMNS, num_warps=WARPS, **FUSED,
    )  # fmt: skip
    entries_end = torch.cumsum(counts, 0)
    count = int(entries_end[-1])
    close = [torch.empty(count, dtype=kind, device=device) for kind in types]
    gather_kernel[grid](
        *roomy, projection.starts, columns.counts, ends, entries_end, counts, *close, lot.tiles.start, lot.before,
        BLOCK=_BLOCK, **FUSED,
    )  # fmt: skip
    return close[0], close[1]


def _merge(keys: Tensor, weights: Tensor, n_combinations: int, scale: float) -> tuple[Tensor, Tensor, Tensor]:
    """Add up the weights of equal keys; return Gaussian, combination, weight (int32, int32, float32), sorted.

    Sums of whole numbers are the same in any order.
    """
    keys, order = torch.sort(keys)
    keys, inverse = torch.unique_consecutive(keys, return_inverse=True)
    totals = torch.zeros(len(keys), dtype=torch.int64, device=keys.device).index_add_(
        0, inverse, weights[order]
    )
    numbers = torch.empty(2, len(keys), dtype=torch.int32, device=keys.device)
    out = torch.empty(len(keys), device=keys.device)
    unpack_kernel[(triton.cdiv(len(keys), _BLOCK),)](
        keys, totals, numbers[0], numbers[1], out, len(keys), n_combinations, scale, BLOCK=_BLOCK, **FUSED
    )
    return numbers[0], numbers[1], out
