"""Cosines and features of rendered codes, computed where the coefficients are."""

# pyright: reportArgumentType=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false, reportAssignmentType=false

from __future__ import annotations

import triton
import triton.language as tl

from scoup.raster.triton.kernels.blending import LOW_SCALE, halves, pixels_of
from scoup.raster.triton.kernels.codes import accumulate_codes

TINY = tl.constexpr(1.1754943508222875e-38)  # the smallest normal float32


@triton.jit(
    do_not_specialize=["width", "height", "across", "n_levels", "n_atoms", "n_columns", "first_level"]
)
def products_kernel(
    records,  # [., RECORD] float32
    numbers,  # the same memory as int32
    starts,  # [tiles + 1] int64
    words,  # [N, S, GROUPS * SLOTS], see ``pack_kernel``
    grams,  # [2, S, L, L] float16, as ``halves``
    tables,  # [2, S, L, C] float16, as ``halves``: what the coefficients are multiplied with
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
    CHUNK: tl.constexpr,
    LEVELS: tl.constexpr,
    GROUPS: tl.constexpr,
    ATOMS: tl.constexpr,
    WIDE: tl.constexpr,
    COLUMNS: tl.constexpr,
    PIXELS_LAST: tl.constexpr,
    PRECISION: tl.constexpr,
):
    """W B / sqrt(W G W^T) of the coefficients W of each pixel, all atoms at once: cosines with queries where B is the
    codebook times the queries, features of unit norm where B is the codebook. The coefficients never leave the chip.
    """
    tile = tl.program_id(0)
    x, y, pixel, inside = pixels_of(tile, across, width, height, TILE)
    start, end = tl.load(starts + tile), tl.load(starts + tile + 1)
    sums_0, sums_1, sums_2, sums_3 = accumulate_codes(
        records, numbers, start, end, words, first_level, n_levels, 0, x, y, inside, alpha_max, stop,
        STOP_INCLUSIVE, CHUNK, LEVELS, GROUPS, ATOMS, WIDE, PRECISION,
    )  # fmt: skip
    pixels = height.to(tl.int64) * width
    store_products(
        sums_0, grams, tables, out, first_level, pixel, pixels, inside, n_levels, n_atoms, n_columns, COLUMNS,
        PIXELS_LAST,
    )  # fmt: skip
    if LEVELS > 1:
        store_products(
            sums_1, grams, tables, out, first_level + 1, pixel, pixels, inside, n_levels, n_atoms, n_columns,
            COLUMNS, PIXELS_LAST,
        )  # fmt: skip
    if LEVELS > 2:
        store_products(
            sums_2, grams, tables, out, first_level + 2, pixel, pixels, inside, n_levels, n_atoms, n_columns,
            COLUMNS, PIXELS_LAST,
        )  # fmt: skip
    if LEVELS > 3:
        store_products(
            sums_3, grams, tables, out, first_level + 3, pixel, pixels, inside, n_levels, n_atoms, n_columns,
            COLUMNS, PIXELS_LAST,
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
    n_levels,
    n_atoms,
    n_columns,
    COLUMNS: tl.constexpr,
    PIXELS_LAST: tl.constexpr,
):
    """One level of ``products_kernel``; pixels without coefficients get 0. Tables have entries of about 1 at most."""
    PIXELS: tl.constexpr = coefficients.shape[0]
    ATOMS: tl.constexpr = coefficients.shape[1]
    largest = tl.max(coefficients, axis=1)
    coefficients *= tl.where(largest > 0, 1.0 / tl.maximum(largest, TINY), 0.0)[:, None]
    # W G W^T, so many columns of G at a time as fit.
    OTHERS: tl.constexpr = ATOMS if ATOMS <= 64 else 4096 // ATOMS
    squared = tl.zeros([PIXELS], tl.float32)
    for first in range(0, ATOMS, OTHERS):
        products = times_table(coefficients, grams, level, n_levels, n_atoms, n_atoms, first, OTHERS)
        if OTHERS < ATOMS:  # columns of a tensor in registers can be had as a product only
            one_hot = tl.arange(0, ATOMS)[:, None] == first + tl.arange(0, OTHERS)[None, :]
            squared += tl.sum(products * times_ones(coefficients, one_hot), axis=1)
        else:
            squared += tl.sum(products * coefficients, axis=1)
    inverse = tl.where(squared > 0, 1.0 / tl.sqrt(tl.maximum(squared, TINY)), 0.0)
    for first in range(0, n_columns, COLUMNS):
        values = times_table(coefficients, tables, level, n_levels, n_atoms, n_columns, first, COLUMNS)
        values *= inverse[:, None]
        column = first + tl.arange(0, COLUMNS)
        if PIXELS_LAST:
            target = (level.to(tl.int64) * n_columns + column)[None, :] * pixels + pixel[:, None]
        else:
            target = (level.to(tl.int64) * pixels + pixel)[:, None] * n_columns + column[None, :]
        tl.store(out + target, values, mask=inside[:, None] & (column < n_columns)[None, :])


@triton.jit
def times_table(
    coefficients,  # [P, L]
    table,  # [2, S, L, C] float16
    level,
    n_levels,
    n_atoms,
    n_columns,
    first,
    COLUMNS: tl.constexpr,
):
    """[P, COLUMNS] coefficients times the columns from ``first`` on of a level of a table."""
    nothing = tl.zeros([coefficients.shape[0], COLUMNS], tl.float32)
    atom, column = tl.arange(0, coefficients.shape[1]), first + tl.arange(0, COLUMNS)
    there = (atom < n_atoms)[:, None] & (column < n_columns)[None, :]
    entries = table + (level.to(tl.int64) * n_atoms + atom[:, None]) * n_columns + column[None, :]
    high, low = halves(coefficients)
    other_high = tl.load(entries, mask=there, other=0.0)
    other_low = tl.load(entries + n_levels.to(tl.int64) * n_atoms * n_columns, mask=there, other=0.0)
    small = tl.dot(high, other_low, nothing)
    small = tl.dot(low, other_high, small)
    return tl.dot(high, other_high, small * (1.0 / LOW_SCALE))


@triton.jit
def times_ones(coefficients, ones):
    """Coefficients times zeros and ones: no digit of these is lost."""
    high, low = halves(coefficients)
    small = tl.dot(low, ones.to(tl.float16))
    return tl.dot(high, ones.to(tl.float16), small * (1.0 / LOW_SCALE))
