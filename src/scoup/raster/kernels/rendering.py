"""Rendering of dense channels and of sparse codes, with what is asked of the coefficients computed where they are."""

# pyright: reportArgumentType=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false, reportAssignmentType=false

from __future__ import annotations

import triton
import triton.language as tl

from scoup.raster.kernels.blending import (
    WEIGHT_SCALE,
    blend,
    load_chunk,
    pixel_block,
    product,
    product_with_ones,
)

TINY = tl.constexpr(1.1754943508222875e-38)  # the smallest normal float32


@triton.jit(do_not_specialize=["width", "height", "across", "n_channels"])
def channels_kernel(
    pair_ids,  # [P] int32
    corners,  # [P, 2] float32
    records,  # [N, 4] float32
    starts,  # [tiles + 1] int64
    values,  # [N, C] float32
    image,  # [H, W, C] float32: out
    coverage,  # [H, W] float32: out
    width,
    height,
    across,
    n_channels,
    alpha_max,
    stop,
    STOP_INCLUSIVE: tl.constexpr,
    TILE: tl.constexpr,
    PIXELS: tl.constexpr,
    CHUNK: tl.constexpr,
    CHANNELS: tl.constexpr,
    PRECISION: tl.constexpr,
):
    """One program renders a block of channels of a part of a tile."""
    PARTS: tl.constexpr = TILE * TILE // PIXELS
    tile, part, block = tl.program_id(0) // PARTS, tl.program_id(0) % PARTS, tl.program_id(1)
    x, y, pixel, inside = pixel_block(tile, part, across, width, height, TILE, PIXELS)
    channel = block * CHANNELS + tl.arange(0, CHANNELS)
    in_range = channel < n_channels
    sums = tl.zeros([PIXELS, CHANNELS], tl.float32)
    covered = tl.zeros([PIXELS], tl.float32)
    transmittance = tl.where(inside, 1.0, 0.0)
    start, end = tl.load(starts + tile), tl.load(starts + tile + 1)
    # The next chunk is on its way while this one is blended.
    gaussian, u, v, ku, skew, kv, peak = load_chunk(pair_ids, corners, records, start, end, CHUNK)
    while start < end:
        next_gaussian, next_u, next_v, next_ku, next_skew, next_kv, next_peak = load_chunk(
            pair_ids, corners, records, start + CHUNK, end, CHUNK
        )
        rows = values + gaussian.to(tl.int64)[:, None] * n_channels + channel[None, :]
        there = (peak > -float("inf"))[:, None] & in_range[None, :]
        own = tl.load(rows, mask=there, other=0.0)
        weights, transmittance = blend(
            x, y, u, v, ku, skew, kv, peak, transmittance, alpha_max, stop, STOP_INCLUSIVE
        )
        sums = product(weights, own, sums, PRECISION)
        covered += tl.sum(weights, axis=1)
        going_on = tl.max(transmittance, axis=0) > 0
        start = tl.where(going_on, start + CHUNK, end)
        gaussian, u, v, ku, skew, kv, peak = (
            next_gaussian,
            next_u,
            next_v,
            next_ku,
            next_skew,
            next_kv,
            next_peak,
        )
    out = image + pixel.to(tl.int64)[:, None] * n_channels + channel[None, :]
    tl.store(out, sums, mask=inside[:, None] & in_range[None, :])
    if block == 0:
        tl.store(coverage + pixel, covered, mask=inside)


@triton.jit
def dense_codes(
    gaussian,  # [G]
    there,  # [G]
    indices,
    weights,
    level,
    n_levels,
    first_atom,
    K: tl.constexpr,
    ATOMS: tl.constexpr,
):
    """[G, L] float32: sparse codes of one level over the atoms from ``first_atom`` on."""
    own = (gaussian.to(tl.int64) * n_levels + level) * K
    atom = first_atom + tl.arange(0, ATOMS)
    dense = tl.zeros([gaussian.shape[0], ATOMS], tl.float32)
    for slot in tl.static_range(K):
        index = tl.load(indices + own + slot, mask=there, other=0).to(tl.int32)
        weight = tl.load(weights + own + slot, mask=there, other=0.0).to(tl.float32)
        dense += tl.where(index[:, None] == atom[None, :], weight[:, None], 0.0)
    return dense


@triton.jit
def accumulate_codes(
    pair_ids,
    corners,
    records,
    start,
    end,
    indices,
    weights,
    level,
    n_levels,
    first_atom,
    x,
    y,
    inside,
    alpha_max,
    stop,
    STOP_INCLUSIVE: tl.constexpr,
    CHUNK: tl.constexpr,
    LEVELS: tl.constexpr,
    K: tl.constexpr,
    ATOMS: tl.constexpr,
    PRECISION: tl.constexpr,
):
    """Coefficients [P, L], times WEIGHT_SCALE, of up to four levels from ``level`` on; those beyond LEVELS are of no
    use.
    """
    PIXELS: tl.constexpr = x.shape[0]
    sums_0 = tl.zeros([PIXELS, ATOMS], tl.float32)
    sums_1 = tl.zeros([PIXELS, ATOMS if LEVELS > 1 else 1], tl.float32)
    sums_2 = tl.zeros([PIXELS, ATOMS if LEVELS > 2 else 1], tl.float32)
    sums_3 = tl.zeros([PIXELS, ATOMS if LEVELS > 3 else 1], tl.float32)
    transmittance = tl.where(inside, 1.0, 0.0)
    gaussian, u, v, ku, skew, kv, peak = load_chunk(pair_ids, corners, records, start, end, CHUNK)
    while start < end:
        next_gaussian, next_u, next_v, next_ku, next_skew, next_kv, next_peak = load_chunk(
            pair_ids, corners, records, start + CHUNK, end, CHUNK
        )
        blending, transmittance = blend(
            x, y, u, v, ku, skew, kv, peak, transmittance, alpha_max, stop, STOP_INCLUSIVE
        )
        blending *= WEIGHT_SCALE
        there = peak > -float("inf")
        dense = dense_codes(gaussian, there, indices, weights, level, n_levels, first_atom, K, ATOMS)
        sums_0 = product(blending, dense, sums_0, PRECISION)
        if LEVELS > 1:
            dense = dense_codes(gaussian, there, indices, weights, level + 1, n_levels, first_atom, K, ATOMS)
            sums_1 = product(blending, dense, sums_1, PRECISION)
        if LEVELS > 2:
            dense = dense_codes(gaussian, there, indices, weights, level + 2, n_levels, first_atom, K, ATOMS)
            sums_2 = product(blending, dense, sums_2, PRECISION)
        if LEVELS > 3:
            dense = dense_codes(gaussian, there, indices, weights, level + 3, n_levels, first_atom, K, ATOMS)
            sums_3 = product(blending, dense, sums_3, PRECISION)
        going_on = tl.max(transmittance, axis=0) > 0
        start = tl.where(going_on, start + CHUNK, end)
        gaussian, u, v, ku, skew, kv, peak = (
            next_gaussian,
            next_u,
            next_v,
            next_ku,
            next_skew,
            next_kv,
            next_peak,
        )
    return sums_0, sums_1, sums_2, sums_3


@triton.jit(do_not_specialize=["width", "height", "across", "n_levels", "n_atoms", "first_level"])
def codes_kernel(
    pair_ids,  # [P] int32
    corners,  # [P, 2] float32
    records,  # [N, 4] float32
    starts,  # [tiles + 1] int64
    indices,  # [N, S, K] unsigned
    weights,  # [N, S, K] float16 or float32
    out,  # [S, H, W, L] float32
    width,
    height,
    across,
    n_levels,
    n_atoms,
    first_level,
    alpha_max,
    stop,
    STOP_INCLUSIVE: tl.constexpr,
    TILE: tl.constexpr,
    PIXELS: tl.constexpr,
    CHUNK: tl.constexpr,
    LEVELS: tl.constexpr,
    K: tl.constexpr,
    ATOMS: tl.constexpr,
    PRECISION: tl.constexpr,
):
    """One program renders a block of atoms of some levels at a part of a tile."""
    PARTS: tl.constexpr = TILE * TILE // PIXELS
    tile, part, block = tl.program_id(0) // PARTS, tl.program_id(0) % PARTS, tl.program_id(1)
    x, y, pixel, inside = pixel_block(tile, part, across, width, height, TILE, PIXELS)
    sums_0, sums_1, sums_2, sums_3 = accumulate_codes(
        pair_ids,
        corners,
        records,
        tl.load(starts + tile),
        tl.load(starts + tile + 1),
        indices,
        weights,
        first_level,
        n_levels,
        block * ATOMS,
        x,
        y,
        inside,
        alpha_max,
        stop,
        STOP_INCLUSIVE,
        CHUNK,
        LEVELS,
        K,
        ATOMS,
        PRECISION,
    )
    atom = block * ATOMS + tl.arange(0, ATOMS)
    stored = inside[:, None] & (atom < n_atoms)[None, :]
    plane = height.to(tl.int64) * width * n_atoms
    own = out + first_level * plane + pixel.to(tl.int64)[:, None] * n_atoms + atom[None, :]
    tl.store(own, sums_0 * (1.0 / WEIGHT_SCALE), mask=stored)
    if LEVELS > 1:
        tl.store(own + plane, sums_1 * (1.0 / WEIGHT_SCALE), mask=stored)
    if LEVELS > 2:
        tl.store(own + 2 * plane, sums_2 * (1.0 / WEIGHT_SCALE), mask=stored)
    if LEVELS > 3:
        tl.store(own + 3 * plane, sums_3 * (1.0 / WEIGHT_SCALE), mask=stored)


@triton.jit(
    do_not_specialize=["width", "height", "across", "n_levels", "n_atoms", "n_columns", "first_level"]
)
def products_kernel(
    pair_ids,  # [P] int32
    corners,  # [P, 2] float32
    records,  # [N, 4] float32
    starts,  # [tiles + 1] int64
    indices,  # [N, S, K] unsigned
    weights,  # [N, S, K] float16 or float32
    grams,  # [S, L, L] float32
    tables,  # [S, L, C] float32: what the coefficients are multiplied with
    out,  # [S, C, H, W] float32 for cosines; [S, H, W, C] for features
    width,
    height,
    across,
    n_levels,
    n_atoms,
    n_columns,
    first_level,
    alpha_max,
    stop,
    STOP_INCLUSIVE: tl.constexpr,
    TILE: tl.constexpr,
    PIXELS: tl.constexpr,
    CHUNK: tl.constexpr,
    LEVELS: tl.constexpr,
    K: tl.constexpr,
    ATOMS: tl.constexpr,
    COLUMNS: tl.constexpr,
    PIXELS_LAST: tl.constexpr,
    PRECISION: tl.constexpr,
    TABLE_PRECISION: tl.constexpr,
):
    """W B / sqrt(W G W^T) of the coefficients W of each pixel, all atoms at once: cosines with queries where B is the
    codebook times the queries, features of unit norm where B is the codebook. The coefficients never leave the chip.
    """
    PARTS: tl.constexpr = TILE * TILE // PIXELS
    tile, part = tl.program_id(0) // PARTS, tl.program_id(0) % PARTS
    x, y, pixel, inside = pixel_block(tile, part, across, width, height, TILE, PIXELS)
    sums_0, sums_1, sums_2, sums_3 = accumulate_codes(
        pair_ids,
        corners,
        records,
        tl.load(starts + tile),
        tl.load(starts + tile + 1),
        indices,
        weights,
        first_level,
        n_levels,
        0,
        x,
        y,
        inside,
        alpha_max,
        stop,
        STOP_INCLUSIVE,
        CHUNK,
        LEVELS,
        K,
        ATOMS,
        PRECISION,
    )
    pixels = height.to(tl.int64) * width
    store_products(
        sums_0, grams, tables, out, first_level, pixel, pixels, inside, n_atoms, n_columns, COLUMNS, PIXELS_LAST,
        TABLE_PRECISION,
    )  # fmt: skip
    if LEVELS > 1:
        store_products(
            sums_1, grams, tables, out, first_level + 1, pixel, pixels, inside, n_atoms, n_columns, COLUMNS,
            PIXELS_LAST, TABLE_PRECISION,
        )  # fmt: skip
    if LEVELS > 2:
        store_products(
            sums_2, grams, tables, out, first_level + 2, pixel, pixels, inside, n_atoms, n_columns, COLUMNS,
            PIXELS_LAST, TABLE_PRECISION,
        )  # fmt: skip
    if LEVELS > 3:
        store_products(
            sums_3, grams, tables, out, first_level + 3, pixel, pixels, inside, n_atoms, n_columns, COLUMNS,
            PIXELS_LAST, TABLE_PRECISION,
        )  # fmt: skip


@triton.jit
def store_products(
    coefficients,  # [P, L]
    grams,
    tables,
    out,
    level,
    pixel,  # [P]
    pixels,
    inside,  # [P]
    n_atoms,
    n_columns,
    COLUMNS: tl.constexpr,
    PIXELS_LAST: tl.constexpr,
    PRECISION: tl.constexpr,
):
    """One level of ``products_kernel``; pixels without coefficients get 0. Tables have entries of about 1 at most."""
    PIXELS: tl.constexpr = coefficients.shape[0]
    ATOMS: tl.constexpr = coefficients.shape[1]
    largest = tl.max(coefficients, axis=1)
    coefficients *= tl.where(largest > 0, 1.0 / tl.maximum(largest, TINY), 0.0)[:, None]
    atom = tl.arange(0, ATOMS)
    table = level.to(tl.int64) * n_atoms
    # W G W^T, so many columns of G at a time as fit.
    OTHERS: tl.constexpr = ATOMS if ATOMS <= 128 and PRECISION == "fp16x3" else 16
    squared = tl.zeros([PIXELS], tl.float32)
    for first in range(0, ATOMS, OTHERS):
        other = first + tl.arange(0, OTHERS)
        both = (atom < n_atoms)[:, None] & (other < n_atoms)[None, :]
        gram = tl.load(grams + (table + atom[:, None]) * n_atoms + other[None, :], mask=both, other=0.0)
        nothing = tl.zeros([PIXELS, OTHERS], tl.float32)
        products = product(coefficients, gram, nothing, PRECISION)
        if OTHERS < ATOMS:  # columns of a tensor in registers can be had as a product only
            own = product_with_ones(coefficients, atom[:, None] == other[None, :], nothing, PRECISION)
            squared += tl.sum(products * own, axis=1)
        else:
            squared += tl.sum(products * coefficients, axis=1)
    inverse = tl.where(squared > 0, 1.0 / tl.sqrt(tl.maximum(squared, TINY)), 0.0)
    for first in range(0, n_columns, COLUMNS):
        column = first + tl.arange(0, COLUMNS)
        in_range = column < n_columns
        part = tl.load(
            tables + (table + atom[:, None]) * n_columns + column[None, :],
            mask=(atom < n_atoms)[:, None] & in_range[None, :],
            other=0.0,
        )
        found = product(coefficients, part, tl.zeros([PIXELS, COLUMNS], tl.float32), PRECISION)
        found *= inverse[:, None]
        if PIXELS_LAST:
            place = (level.to(tl.int64) * n_columns + column)[None, :] * pixels + pixel[:, None]
        else:
            place = (level.to(tl.int64) * pixels + pixel)[:, None] * n_columns + column[None, :]
        tl.store(out + place, found, mask=inside[:, None] & in_range[None, :])
