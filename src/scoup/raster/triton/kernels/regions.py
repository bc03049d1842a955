"""Region sums of a projection: the contribution of each Gaussian to each combination of regions, tile by tile.

The pixels of a tile that have the same combination are one column. A Gaussian's sums over the columns of a tile are a
row of E @ one-hot(columns), which serves all levels at once. What is not zero becomes an entry.
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
    gaussians_of,
    halves_of_weights,
    is_lit,
    pixels_of,
)


@triton.jit(do_not_specialize=["width", "height", "across"])
def columns_kernel(
    labels,  # [H, W] int32: combination of each pixel, -1 for none
    starts,  # [tiles + 1] int64: of the records of each tile
    columns,  # [tiles, P] int16: out, column of each pixel, -1 for none
    combinations,  # [tiles, P] int32: out, combination of each column
    n_columns,  # [tiles] int32: out
    room,  # [tiles] int64: out, columns times Gaussians
    width,
    height,
    across,
    TILE: tl.constexpr,
):
    """Columns are in the order of their first pixels."""
    PIXELS: tl.constexpr = TILE * TILE
    tile = tl.program_id(0)
    _, _, image_pixel, inside = pixels_of(tile, across, width, height, TILE)
    label = tl.load(labels + image_pixel, mask=inside, other=-1)
    pixel = tl.arange(0, PIXELS)
    same = label[:, None] == label[None, :]
    first = tl.min(tl.where(same, pixel[None, :], PIXELS), axis=1)
    # Compute it again along the other dimension: cheaper than converting the layout.
    first_across = tl.min(tl.where(same, pixel[:, None], PIXELS), axis=0)
    label_across = tl.load(labels + image_pixel, mask=inside, other=-1)
    begins = (first_across == pixel) & (label_across >= 0)
    column = tl.sum((begins[None, :] & (pixel[None, :] < first[:, None])).to(tl.int32), axis=1)
    tile_start = tile.to(tl.int64) * PIXELS
    tl.store(columns + tile_start + pixel, tl.where(label >= 0, column, -1).to(tl.int16))
    tl.store(combinations + tile_start + column, label, mask=(first == pixel) & (label >= 0))
    count = tl.sum(begins.to(tl.int32), axis=0)
    tl.store(n_columns + tile, count)
    tl.store(room + tile, (tl.load(starts + tile + 1) - tl.load(starts + tile)) * count)


@triton.jit(do_not_specialize=["width", "height", "across", "first_tile", "before", "n_combinations"])
def region_sums_kernel(
    records,  # [., RECORD] float32
    numbers,  # the same memory as int32
    starts,  # [tiles + 1] int64
    columns,  # [tiles, P] int16: column of each pixel, -1 for none
    combinations,  # [tiles, P] int32: combination of each column
    n_columns,  # [tiles] int32
    ends,  # [tiles] int64: where there is room for the entries of the next tile
    keys,  # int32 or int64: out, Gaussian times n_combinations plus combination
    weights,  # int64: out, whole numbers of 1 / ``scale`` pixels
    n_entries,  # [launched tiles] int32: out
    width,
    height,
    across,
    first_tile,
    before,  # room for tiles before the first one
    n_combinations,
    scale,
    alpha_max,
    stop,
    STOP_INCLUSIVE: tl.constexpr,
    TILE: tl.constexpr,
    CHUNK: tl.constexpr,
    COLUMNS: tl.constexpr,
):
    """One program per tile. The few tiles with more than COLUMNS columns take one pass per COLUMNS of them."""
    PIXELS: tl.constexpr = TILE * TILE
    tile = first_tile + tl.program_id(0)
    x, y, _, inside = pixels_of(tile, across, width, height, TILE)
    column_of = tl.load(columns + tile * PIXELS + tl.arange(0, PIXELS)).to(tl.int32)
    count = tl.load(n_columns + tile)
    first, end = tl.load(starts + tile), tl.load(starts + tile + 1)
    room = tl.load(ends + tile) - (end - first) * count - before
    keys += room
    weights += room
    written = 0
    for block in range(0, count, COLUMNS):
        column = block + tl.arange(0, COLUMNS)
        combination = tl.load(combinations + tile * PIXELS + column, mask=column < count, other=0)
        one_hot = column_of[:, None] == column[None, :]
        transmittance = tl.where(inside, 1.0, 0.0)[None, :]
        start = first
        while start < end:
            blended, transmittance = blend(
                records, start, end, x, y, transmittance, alpha_max, stop, STOP_INCLUSIVE, CHUNK, WEIGHT_SCALE
            )
            sums = tl.zeros([CHUNK, COLUMNS], tl.float32)
            high, low = halves_of_weights(blended)
            sums = add_product(high, low, one_hot.to(tl.float16), sums)
            gaussian, there = gaussians_of(numbers, start, end, CHUNK)
            positive = there[:, None] & (column < count)[None, :] & (sums > 0)
            ones = positive.to(tl.int32)
            of_row = tl.sum(ones, axis=1)
            rows_before = tl.cumsum(of_row, axis=0) - of_row
            target = written + rows_before[:, None] + tl.cumsum(ones, axis=1) - 1
            key = gaussian.to(tl.int64)[:, None] * n_combinations + combination[None, :]
            tl.store(keys + target, key.to(keys.dtype.element_ty), mask=positive)
            whole = (sums.to(tl.float64) * (scale / WEIGHT_SCALE) + 0.5).to(tl.int64)
            tl.store(weights + target, whole, mask=positive)
            written += tl.sum(of_row, axis=0)
            start = tl.where(is_lit(transmittance), start + CHUNK, end)
    tl.store(n_entries + tl.program_id(0), written)


@triton.jit(do_not_specialize=["first_tile", "before"])
def gather_kernel(
    keys,  # int32 or int64: of all tiles, with room between them
    weights,  # int64
    starts,  # [tiles + 1] int64
    n_columns,  # [tiles] int32
    ends,  # [tiles] int64, see ``region_sums_kernel``
    entries_end,  # [launched tiles] int64: where entries of the next tile begin without room between them
    n_entries,  # [launched tiles] int32
    keys_out,
    weights_out,
    first_tile,
    before,
    BLOCK: tl.constexpr,
):
    """Move the entries of each tile next to each other."""
    here = tl.program_id(0)
    tile = first_tile + here
    length = (tl.load(starts + tile + 1) - tl.load(starts + tile)) * tl.load(n_columns + tile)
    source = tl.load(ends + tile) - length - before
    count = tl.load(n_entries + here)
    target = tl.load(entries_end + here) - count
    for first in range(0, count, BLOCK):
        entry = first + tl.arange(0, BLOCK)
        there = entry < count
        tl.store(keys_out + target + entry, tl.load(keys + source + entry, mask=there), mask=there)
        tl.store(weights_out + target + entry, tl.load(weights + source + entry, mask=there), mask=there)


@triton.jit(do_not_specialize=["count", "n_combinations"])
def unpack_kernel(
    keys,  # [E] int32 or int64
    totals,  # [E] int64
    gaussians,  # [E] int32: out
    combinations,  # [E] int32: out
    weights,  # [E] float32: out
    count,
    n_combinations,
    scale,
    BLOCK: tl.constexpr,
):
    """Keys and whole numbers of ``region_sums_kernel`` become entries."""
    entry = tl.program_id(0).to(tl.int64) * BLOCK + tl.arange(0, BLOCK)
    there = entry < count
    key = tl.load(keys + entry, mask=there, other=0)
    gaussian = key // n_combinations
    tl.store(gaussians + entry, gaussian.to(tl.int32), mask=there)
    tl.store(combinations + entry, (key - gaussian * n_combinations).to(tl.int32), mask=there)
    total = tl.load(totals + entry, mask=there, other=0).to(tl.float64)
    tl.store(weights + entry, (total / scale).to(tl.float32), mask=there)
