"""Region sums of a view: how much each Gaussian paints of each region, tile by tile.

The pixels of a tile that have the same region at every level are one column. A Gaussian's sums over the columns of a
tile are a row of E^T @ one-hot(columns), which serves all levels at once.
"""

# pyright: reportArgumentType=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false

from __future__ import annotations

import triton
import triton.language as tl

from scoup.raster.kernels.blending import (
    WEIGHT_SCALE,
    blend,
    load_chunk,
    pixel_block,
    product_with_ones,
)


@triton.jit(do_not_specialize=["width", "height", "across", "n_levels"])
def alike_kernel(
    labels,  # [S, H, W] integers
    first_alike,  # [tiles, P] int32: out
    width,
    height,
    across,
    n_levels,
    TILE: tl.constexpr,
    OTHERS: tl.constexpr,
):
    """The first pixel of the tile that has the same region as a pixel at every level; P for pixels without any."""
    tile = tl.program_id(0)
    PIXELS: tl.constexpr = TILE * TILE
    _, _, pixel, inside = pixel_block(tile, 0, across, width, height, TILE, PIXELS)
    plane = height.to(tl.int64) * width
    has_region = tl.zeros([PIXELS], tl.int1)
    for level in range(n_levels):
        own = tl.load(labels + level * plane + pixel, mask=inside, other=-1)
        has_region |= own >= 0
    found = tl.full([PIXELS], PIXELS, tl.int32)
    for first in range(0, PIXELS, OTHERS):
        other = first + tl.arange(0, OTHERS)
        x, y = other % TILE, other // TILE
        column, row = tile % across * TILE + x, tile // across * TILE + y
        other_inside = (column < width) & (row < height)
        alike = has_region[:, None] & other_inside[None, :]
        for level in range(n_levels):
            own = tl.load(labels + level * plane + pixel, mask=inside, other=-1)
            their = tl.load(labels + level * plane + row * width + column, mask=other_inside, other=-1)
            # Every number below 0 means that there is no region.
            alike &= tl.maximum(own, -1)[:, None] == tl.maximum(their, -1)[None, :]
        found = tl.minimum(found, tl.min(tl.where(alike, other[None, :], PIXELS), axis=1))
    tl.store(first_alike + tile * PIXELS + tl.arange(0, PIXELS), found)


@triton.jit(do_not_specialize=["width", "height", "across", "first_tile"])
def region_sums_kernel(
    pair_ids,  # [P] int32
    corners,  # [P, 2] float32
    records,  # [N, 4] float32
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
    PRECISION: tl.constexpr,
):
    tile = first_tile + tl.program_id(0)
    HALF: tl.constexpr = (
        TILE * TILE // 2
    )  # pixels go in two parts: the weights of all are too much for the registers
    x, y, _, inside = pixel_block(tile, 0, across, width, height, TILE, HALF)
    x_1, y_1, _, inside_1 = pixel_block(tile, 1, across, width, height, TILE, HALF)
    of_pixel = columns + tile * (TILE * TILE) + tl.arange(0, HALF)
    column_of, column_of_1 = tl.load(of_pixel).to(tl.int32), tl.load(of_pixel + HALF).to(tl.int32)
    count = tl.load(n_columns + tile)
    left, left_1 = tl.where(inside, 1.0, 0.0), tl.where(inside_1, 1.0, 0.0)
    first, end = tl.load(starts + tile), tl.load(starts + tile + 1)
    start = tl.where(count > 0, first, end)
    base = sums + tl.load(bases + tile)
    _, u, v, ku, skew, kv, peak = load_chunk(pair_ids, corners, records, start, end, CHUNK)
    while start < end:
        _, next_u, next_v, next_ku, next_skew, next_kv, next_peak = load_chunk(
            pair_ids, corners, records, start + CHUNK, end, CHUNK
        )
        weights, left = blend(x, y, u, v, ku, skew, kv, peak, left, alpha_max, stop, STOP_INCLUSIVE)
        weights_1, left_1 = blend(x_1, y_1, u, v, ku, skew, kv, peak, left_1, alpha_max, stop, STOP_INCLUSIVE)
        row = start - first + tl.arange(0, CHUNK)
        for block in range(0, count, COLUMNS):
            column = block + tl.arange(0, COLUMNS)
            found = tl.zeros([CHUNK, COLUMNS], tl.float32)
            one_hot = column_of[:, None] == column[None, :]
            found = product_with_ones(tl.trans(weights * WEIGHT_SCALE), one_hot, found, PRECISION)
            one_hot = column_of_1[:, None] == column[None, :]
            found = product_with_ones(tl.trans(weights_1 * WEIGHT_SCALE), one_hot, found, PRECISION)
            found *= 1.0 / WEIGHT_SCALE  # a power of two: exact
            stored = (row < end - first)[:, None] & (column < count)[None, :]
            tl.store(base + row[:, None] * count + column[None, :], found, mask=stored)
        going_on = tl.maximum(tl.max(left, axis=0), tl.max(left_1, axis=0)) > 0
        start = tl.where(going_on, start + CHUNK, end)
        u, v, ku, skew, kv, peak = next_u, next_v, next_ku, next_skew, next_kv, next_peak
