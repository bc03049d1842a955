"""Region sums of a projection: how much each Gaussian contributes to each combination of regions, tile by tile.

The pixels of a tile that have the same combination are one column. A Gaussian's sums over the columns of a tile are a
row of E @ one-hot(columns), which serves all levels at once.
"""

# pyright: reportArgumentType=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false

from __future__ import annotations

import triton
import triton.language as tl

from scoup.raster.triton.kernels.blending import (
    WEIGHT_SCALE,
    add_product,
    blend,
    halves_of_weights,
    is_lit,
    pixels_of,
)


@triton.jit(do_not_specialize=["width", "height", "across", "first_tile"])
def region_sums_kernel(
    records,  # [., RECORD] float32
    starts,  # [tiles + 1] int64
    columns,  # [tiles, P] int16: column of each pixel, -1 for none
    n_columns,  # [tiles] int32
    bases,  # [tiles] int64: where a tile's sums begin
    sums,  # float32: out, for each tile [its Gaussians, its columns]; zeros
    width,
    height,
    across,
    first_tile,
    alpha_max,
    stop,
    STOP_INCLUSIVE: tl.constexpr,
    TILE: tl.constexpr,
    CHUNK: tl.constexpr,
    COLUMNS: tl.constexpr,
):
    """One program a tile. Few tiles have more than COLUMNS columns: they are walked over once more for each so many."""
    tile = first_tile + tl.program_id(0)
    x, y, _, inside = pixels_of(tile, across, width, height, TILE)
    column_of = tl.load(columns + tile * (TILE * TILE) + tl.arange(0, TILE * TILE)).to(tl.int32)
    count = tl.load(n_columns + tile)
    first, end = tl.load(starts + tile), tl.load(starts + tile + 1)
    base = sums + tl.load(bases + tile)
    for block in range(0, count, COLUMNS):
        column = block + tl.arange(0, COLUMNS)
        one_hot = column_of[:, None] == column[None, :]
        transmittance = tl.where(inside, 1.0, 0.0)[None, :]
        start = first
        while start < end:
            weights, transmittance = blend(
                records, start, end, x, y, transmittance, alpha_max, stop, STOP_INCLUSIVE, CHUNK, WEIGHT_SCALE
            )
            found = tl.zeros([CHUNK, COLUMNS], tl.float32)
            high, low = halves_of_weights(weights)
            found = add_product(high, low, one_hot.to(tl.float16), found)
            row = start - first + tl.arange(0, CHUNK)
            stored = (row < end - first)[:, None] & (column < count)[None, :]
            # A power of two: exact.
            tl.store(base + row[:, None] * count + column[None, :], found * (1.0 / WEIGHT_SCALE), mask=stored)
            start = tl.where(is_lit(transmittance), start + CHUNK, end)
