"""Region sums of a projection, on a GPU."""

# A launch takes plain numbers as constants, and options beside the kernel's arguments.
# pyright: reportArgumentType=false, reportCallIssue=false

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from scoup.raster.triton.kernels.regions import region_sums_kernel
from scoup.raster.triton.projection import FUSED, TILE, TritonProjection
from scoup.raster.view_sums import merge

MOST_SUMS = 1 << 27  # float32 numbers at a time: half a gigabyte
CHUNK = 32
COLUMNS = 16
WARPS = 2  # of a program that sums up: a thread per pixel


@dataclass(frozen=True, eq=False)
class Columns:
    """The pixels of each tile by their combination of regions: a column is a combination that some pixel has."""

    of_pixel: Tensor  # [tiles, P] int16, the column of each pixel of a tile, -1 without any region
    counts: Tensor  # [tiles] int32
    firsts: Tensor  # [tiles] int64, where the columns of a tile begin in ``combinations``
    combinations: Tensor  # [C] int32, those of each tile rising


@dataclass(frozen=True, eq=False)
class TileSums:
    """The contribution of each Gaussian to each column, for some of the tiles."""

    values: Tensor  # [.] float32: for each tile [its Gaussians, its columns]
    bases: Tensor  # [tiles] int64: where a tile's values begin, -1 for the other tiles


def region_sums(projection: TritonProjection, combinations: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """See ``raster.region_sums``; ``combinations`` is the map [H, W] of ``CombinedLabels``."""
    columns = columns_of(projection, combinations)
    gaussians = [torch.zeros(0, dtype=torch.int32, device=projection.device)]
    numbers, weights = gaussians[:], [torch.zeros(0, device=projection.device)]
    for sums in tile_sums(projection, columns):
        at = torch.nonzero(sums.values).squeeze(1)
        here = torch.nonzero(sums.bases >= 0).squeeze(1)
        tile = here[torch.searchsorted(sums.bases[here], at, right=True) - 1]
        within = at - sums.bases[tile]
        row = torch.div(within, columns.counts[tile], rounding_mode="floor")
        gaussians.append(projection.pair_ids[projection.starts[tile] + row])
        numbers.append(columns.combinations[columns.firsts[tile] + within - row * columns.counts[tile]])
        weights.append(sums.values[at])
    n_combinations = int(combinations.max()) + 1 if combinations.numel() else 0
    return merge(torch.cat(gaussians), torch.cat(numbers), torch.cat(weights), max(1, n_combinations))


def columns_of(projection: TritonProjection, combinations: Tensor) -> Columns:
    """See ``Columns``; combinations [H, W] int32."""
    down = projection.n_tiles // projection.across
    right, below = projection.across * TILE - projection.width, down * TILE - projection.height
    padded = torch.nn.functional.pad(combinations, (0, right, 0, below), value=-1)
    tiled = (
        padded.view(down, TILE, projection.across, TILE)
        .transpose(1, 2)
        .reshape(projection.n_tiles, TILE * TILE)
    )
    rising, pixel = torch.sort(tiled, dim=1)
    is_first = rising >= 0
    is_first[:, 1:] &= rising[:, 1:] != rising[:, :-1]
    number = torch.cumsum(is_first, 1) - 1
    # Pixels without a region come before the first column: -1 already.
    of_pixel = torch.empty_like(number).scatter_(1, pixel, number)
    counts = is_first.sum(1)
    return Columns(of_pixel.short(), counts.int(), torch.cumsum(counts, 0) - counts, rising[is_first])


def tile_sums(projection: TritonProjection, columns: Columns) -> Iterator[TileSums]:
    """Yield sums, of as many tiles at a time as ``MOST_SUMS`` allows; Gaussians that contribute nothing have zeros."""
    ends = torch.cumsum(projection.starts.diff() * columns.counts, 0)
    total = int(ends[-1]) if len(ends) else 0
    if total <= MOST_SUMS:
        if total:
            yield _sums_of(projection, columns, ends, 0, len(ends), total)
        return
    ends_here = ends.cpu()
    first, before = 0, 0
    while before < total:
        last = int(torch.searchsorted(ends_here, before + MOST_SUMS, right=True))
        last = max(last, first + 1)
        behind = int(ends_here[last - 1])
        if behind > before:
            yield _sums_of(projection, columns, ends, first, last, behind - before)
        first, before = last, behind


def _sums_of(
    projection: TritonProjection, columns: Columns, ends: Tensor, first: int, last: int, count: int
) -> TileSums:
    """Return ``count`` sums, of the tiles from ``first`` to before ``last``; ``ends`` [tiles] is where tiles end."""
    device = projection.device
    begins = torch.nn.functional.pad(ends[:-1], (1, 0))
    values = torch.zeros(count, device=device)
    tiles = torch.arange(projection.n_tiles, device=device)
    here = (tiles >= first) & (tiles < last)
    bases = torch.where(here, begins - begins[first], -1)
    preset = projection.preset
    region_sums_kernel[(last - first,)](
        projection.records, projection.starts, columns.of_pixel, columns.counts, bases, values, projection.width,
        projection.height, projection.across, first, preset.alpha_max, preset.stop,
        STOP_INCLUSIVE=preset.stop_inclusive,
        TILE=TILE, CHUNK=CHUNK, COLUMNS=COLUMNS, num_warps=WARPS, **FUSED,
    )  # fmt: skip
    return TileSums(values, bases)
