"""Rendering of dense channels and of sparse codes, with what is asked of the coefficients computed where they are."""

# pyright: reportArgumentType=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false, reportAssignmentType=false

from __future__ import annotations

import triton
import triton.language as tl

from scoup.raster.kernels.blending import (
    LOW_SCALE,
    WEIGHT_SCALE,
    add_product,
    blend,
    gaussians_of,
    halves,
    halves_of_weights,
    is_lit,
    pixels_of,
)

TINY = tl.constexpr(1.1754943508222875e-38)  # the smallest normal float32
SLOTS = tl.constexpr(4)  # entries of a code that are read at once: 16 bytes


@triton.jit(do_not_specialize=["width", "height", "across", "n_channels"])
def channels_kernel(
    records,  # [., RECORD] float32
    numbers,  # the same memory as int32
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
    CHUNK: tl.constexpr,
    CHANNELS: tl.constexpr,
    PRECISION: tl.constexpr,
):
    """One program renders a block of channels of a tile."""
    tile, block = tl.program_id(0), tl.program_id(1)
    x, y, pixel, inside = pixels_of(tile, across, width, height, TILE)
    channel = block * CHANNELS + tl.arange(0, CHANNELS)
    in_range = channel < n_channels
    sums = tl.zeros([TILE * TILE, CHANNELS], tl.float32)
    covered = tl.zeros([1, TILE * TILE], tl.float32)
    transmittance = tl.where(inside, 1.0, 0.0)[None, :]
    start, end = tl.load(starts + tile), tl.load(starts + tile + 1)
    gaussian, there = gaussians_of(numbers, start, end, CHUNK)
    while start < end:
        rows = values + gaussian.to(tl.int64)[:, None] * n_channels + channel[None, :]
        own = tl.load(rows, mask=there[:, None] & in_range[None, :], other=0.0)
        # Who comes next is on its way while these are blended.
        gaussian, there = gaussians_of(numbers, start + CHUNK, end, CHUNK)
        weights, transmittance = blend(
            records, start, end, x, y, transmittance, alpha_max, stop, STOP_INCLUSIVE, CHUNK, 1.0
        )
        sums = tl.dot(tl.trans(weights), own, sums, input_precision=PRECISION)
        covered += tl.sum(weights, axis=0, keep_dims=True)
        start = tl.where(is_lit(transmittance), start + CHUNK, end)
    out = image + pixel.to(tl.int64)[:, None] * n_channels + channel[None, :]
    tl.store(out, sums, mask=inside[:, None] & in_range[None, :])
    if block == 0:
        tl.store(coverage + pixel[None, :], covered, mask=inside[None, :])


@triton.jit(do_not_specialize=["n_codes", "n_atoms"])
def pack_kernel(
    indices,  # [R, K] unsigned
    weights,  # [R, K] float16 or float32
    words,  # [R, GROUPS * SLOTS] int32, or with WIDE int64: out
    n_codes,
    n_atoms,
    K: tl.constexpr,
    GROUPS: tl.constexpr,
    WIDE: tl.constexpr,
    BLOCK: tl.constexpr,
):
    """An atom and its weight in one integer: the bits of a float16 below 16 bits of the atom, or with WIDE those of a
    float32 below 32. What has no weight or no such atom is 0, which paints nothing. An atom that a code has twice gets
    both weights at its first place.
    """
    row = tl.program_id(0).to(tl.int64) * BLOCK + tl.arange(0, BLOCK)
    there = row < n_codes
    for slot in tl.static_range(GROUPS * SLOTS):
        word = tl.zeros([BLOCK], words.dtype.element_ty)
        if slot < K:
            atom = tl.load(indices + row * K + slot, mask=there, other=0).to(tl.int32)
            total = tl.zeros([BLOCK], tl.float32)
            is_first = there & (atom >= 0) & (atom < n_atoms)
            for other in tl.static_range(K):
                same = tl.load(indices + row * K + other, mask=there, other=0).to(tl.int32) == atom
                weight = tl.load(weights + row * K + other, mask=there, other=0.0).to(tl.float32)
                total += tl.where(same, weight, 0.0)
                if other < slot:
                    is_first &= (same == 0) | (weight == 0)
            if WIDE:
                bits = total.to(tl.int32, bitcast=True).to(tl.int64) & 0xFFFFFFFF
                word = tl.where(is_first, (atom.to(tl.int64) << 32) | bits, 0)
            else:
                bits = total.to(tl.float16).to(tl.int16, bitcast=True).to(tl.int32) & 0xFFFF
                word = tl.where(is_first, (atom << 16) | bits, 0)
        tl.store(words + row * (GROUPS * SLOTS) + slot, word, mask=there)


@triton.jit
def words_of(words, gaussian, there, level, n_levels, GROUP: tl.constexpr, GROUPS: tl.constexpr):
    """[G, SLOTS] of the codes of a chunk at one level."""
    slot = GROUP * SLOTS + tl.arange(0, SLOTS)
    code = gaussian.to(tl.int64) * n_levels + level
    at = code[:, None] * (GROUPS * SLOTS) + slot[None, :]
    return tl.load(words + at, mask=there[:, None], other=0)


@triton.jit
def first_words(
    words, numbers, start, end, level, n_levels, LEVELS: tl.constexpr, GROUPS: tl.constexpr, CHUNK: tl.constexpr
):
    """The first ``words_of`` up to four levels from ``level`` on; those beyond LEVELS are of no use."""
    gaussian, there = gaussians_of(numbers, start, end, CHUNK)
    words_0 = words_of(words, gaussian, there, level, n_levels, 0, GROUPS)
    words_1, words_2, words_3 = words_0, words_0, words_0
    if LEVELS > 1:
        words_1 = words_of(words, gaussian, there, level + 1, n_levels, 0, GROUPS)
    if LEVELS > 2:
        words_2 = words_of(words, gaussian, there, level + 2, n_levels, 0, GROUPS)
    if LEVELS > 3:
        words_3 = words_of(words, gaussian, there, level + 3, n_levels, 0, GROUPS)
    return words_0, words_1, words_2, words_3


@triton.jit
def add_slots(dense, words, first_atom, ATOMS: tl.constexpr, WIDE: tl.constexpr):
    """``dense`` and four entries [G, SLOTS] of each code. With WIDE dense is [L, G] float32; else [L / 2, G] int32, two
    neighbouring atoms in one integer, to which each slot adds the bits of its float16.
    """
    even, odd = tl.split(tl.reshape(words, (words.shape[0], 2, 2)))
    word_0, word_2 = tl.split(even)
    word_1, word_3 = tl.split(odd)
    dense = add_slot(dense, word_0, first_atom, ATOMS, WIDE)
    dense = add_slot(dense, word_1, first_atom, ATOMS, WIDE)
    dense = add_slot(dense, word_2, first_atom, ATOMS, WIDE)
    return add_slot(dense, word_3, first_atom, ATOMS, WIDE)


@triton.jit
def add_slot(dense, word, first_atom, ATOMS: tl.constexpr, WIDE: tl.constexpr):
    """One entry of each code, [G]."""
    if WIDE:
        hit = ((word >> 32).to(tl.int32) - first_atom)[None, :] == tl.arange(0, ATOMS)[:, None]
        value = (word & 0xFFFFFFFF).to(tl.int32).to(tl.float32, bitcast=True)
        dense += tl.where(hit, value[None, :], 0.0)
    else:
        atom = ((word >> 16) & 0xFFFF) - first_atom
        hit = (atom >> 1)[None, :] == tl.arange(0, ATOMS // 2)[:, None]
        value = (word & 0xFFFF) << ((atom & 1) * 16)
        dense += tl.where(hit, value[None, :], 0)
    return dense


@triton.jit
def dense_codes(
    words,  # [G, SLOTS] the first of each code
    all_words,
    numbers,
    start,
    end,
    level,
    n_levels,
    first_atom,
    CHUNK: tl.constexpr,
    GROUPS: tl.constexpr,
    ATOMS: tl.constexpr,
    WIDE: tl.constexpr,
):
    """[G, L] codes over the atoms from ``first_atom`` on, float16 or with WIDE float32."""
    if WIDE:
        dense = tl.zeros([ATOMS, CHUNK], tl.float32)
    else:
        dense = tl.zeros([ATOMS // 2, CHUNK], tl.int32)
    dense = add_slots(dense, words, first_atom, ATOMS, WIDE)
    for group in tl.static_range(1, GROUPS):
        gaussian, there = gaussians_of(numbers, start, end, CHUNK)
        more = words_of(all_words, gaussian, there, level, n_levels, group, GROUPS)
        dense = add_slots(dense, more, first_atom, ATOMS, WIDE)
    if not WIDE:
        even = dense.to(tl.int16).to(tl.float16, bitcast=True)
        odd = (dense >> 16).to(tl.int16).to(tl.float16, bitcast=True)
        dense = tl.reshape(tl.permute(tl.join(even, odd), (0, 2, 1)), (ATOMS, CHUNK))
    return tl.trans(dense)


@triton.jit
def add_codes(sums, blending, dense, WIDE: tl.constexpr, PRECISION: tl.constexpr):
    """``sums`` [P, L] + blending weights [G, P] times dense codes [G, L]."""
    if WIDE:
        sums = tl.dot(tl.trans(blending), dense, sums, input_precision=PRECISION)
    else:
        high, low = halves_of_weights(blending)
        sums = add_product(tl.trans(high), tl.trans(low), dense, sums)
    return sums


@triton.jit
def accumulate_codes(
    records,
    numbers,
    start,
    end,
    words,
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
    GROUPS: tl.constexpr,
    ATOMS: tl.constexpr,
    WIDE: tl.constexpr,
    PRECISION: tl.constexpr,
):
    """Coefficients [P, L], times WEIGHT_SCALE, of up to four levels from ``level`` on; those beyond LEVELS are of no
    use.
    """
    PIXELS: tl.constexpr = x.shape[1]
    sums_0 = tl.zeros([PIXELS, ATOMS], tl.float32)
    sums_1 = tl.zeros([PIXELS, ATOMS if LEVELS > 1 else 1], tl.float32)
    sums_2 = tl.zeros([PIXELS, ATOMS if LEVELS > 2 else 1], tl.float32)
    sums_3 = tl.zeros([PIXELS, ATOMS if LEVELS > 3 else 1], tl.float32)
    transmittance = tl.where(inside, 1.0, 0.0)[None, :]
    words_0, words_1, words_2, words_3 = first_words(
        words, numbers, start, end, level, n_levels, LEVELS, GROUPS, CHUNK
    )
    while start < end:
        # The codes of the next chunk are on their way while this one is blended.
        next_0, next_1, next_2, next_3 = first_words(
            words, numbers, start + CHUNK, end, level, n_levels, LEVELS, GROUPS, CHUNK
        )
        blending, transmittance = blend(
            records, start, end, x, y, transmittance, alpha_max, stop, STOP_INCLUSIVE, CHUNK, WEIGHT_SCALE
        )
        dense = dense_codes(
            words_0, words, numbers, start, end, level, n_levels, first_atom, CHUNK, GROUPS, ATOMS, WIDE
        )
        sums_0 = add_codes(sums_0, blending, dense, WIDE, PRECISION)
        if LEVELS > 1:
            dense = dense_codes(
                words_1, words, numbers, start, end, level + 1, n_levels, first_atom, CHUNK, GROUPS, ATOMS, WIDE
            )
            sums_1 = add_codes(sums_1, blending, dense, WIDE, PRECISION)
        if LEVELS > 2:
            dense = dense_codes(
                words_2, words, numbers, start, end, level + 2, n_levels, first_atom, CHUNK, GROUPS, ATOMS, WIDE
            )
            sums_2 = add_codes(sums_2, blending, dense, WIDE, PRECISION)
        if LEVELS > 3:
            dense = dense_codes(
                words_3, words, numbers, start, end, level + 3, n_levels, first_atom, CHUNK, GROUPS, ATOMS, WIDE
            )
            sums_3 = add_codes(sums_3, blending, dense, WIDE, PRECISION)
        start = tl.where(is_lit(transmittance), start + CHUNK, end)
        words_0, words_1, words_2, words_3 = next_0, next_1, next_2, next_3
    return sums_0, sums_1, sums_2, sums_3


@triton.jit(do_not_specialize=["width", "height", "across", "n_levels", "n_atoms", "first_level"])
def codes_kernel(
    records,  # [., RECORD] float32
    numbers,  # the same memory as int32
    starts,  # [tiles + 1] int64
    words,  # [N, S, GROUPS * SLOTS], see ``pack_kernel``
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
    CHUNK: tl.constexpr,
    LEVELS: tl.constexpr,
    GROUPS: tl.constexpr,
    ATOMS: tl.constexpr,
    WIDE: tl.constexpr,
    PRECISION: tl.constexpr,
):
    """One program renders a block of atoms of some levels of a tile."""
    tile, block = tl.program_id(0), tl.program_id(1)
    x, y, pixel, inside = pixels_of(tile, across, width, height, TILE)
    start, end = tl.load(starts + tile), tl.load(starts + tile + 1)
    sums_0, sums_1, sums_2, sums_3 = accumulate_codes(
        records, numbers, start, end, words, first_level, n_levels, block * ATOMS, x, y, inside, alpha_max, stop,
        STOP_INCLUSIVE, CHUNK, LEVELS, GROUPS, ATOMS, WIDE, PRECISION,
    )  # fmt: skip
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
    records,  # [., RECORD] float32
    numbers,  # the same memory as int32
    starts,  # [tiles + 1] int64
    words,  # [N, S, GROUPS * SLOTS], see ``pack_kernel``
    grams,  # [S, L, L] float32, or [2, S, L, L] float16, see TABLE_PRECISION
    tables,  # [S, L, C] float32, or [2, S, L, C] float16: what the coefficients are multiplied with
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
    TABLE_PRECISION: tl.constexpr,
):
    """W B / sqrt(W G W^T) of the coefficients W of each pixel, all atoms at once: cosines with queries where B is the
    codebook times the queries, features of unit norm where B is the codebook. The coefficients never leave the chip.
    With TABLE_PRECISION "fp16x3" Gram matrices and B come as ``halves``, elsewhere as they are.
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
        PIXELS_LAST, TABLE_PRECISION,
    )  # fmt: skip
    if LEVELS > 1:
        store_products(
            sums_1, grams, tables, out, first_level + 1, pixel, pixels, inside, n_levels, n_atoms, n_columns,
            COLUMNS, PIXELS_LAST, TABLE_PRECISION,
        )  # fmt: skip
    if LEVELS > 2:
        store_products(
            sums_2, grams, tables, out, first_level + 2, pixel, pixels, inside, n_levels, n_atoms, n_columns,
            COLUMNS, PIXELS_LAST, TABLE_PRECISION,
        )  # fmt: skip
    if LEVELS > 3:
        store_products(
            sums_3, grams, tables, out, first_level + 3, pixel, pixels, inside, n_levels, n_atoms, n_columns,
            COLUMNS, PIXELS_LAST, TABLE_PRECISION,
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
    PRECISION: tl.constexpr,
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
        products = times_table(coefficients, grams, level, n_levels, n_atoms, n_atoms, first, OTHERS, PRECISION)
        if OTHERS < ATOMS:  # columns of a tensor in registers can be had as a product only
            one_hot = tl.arange(0, ATOMS)[:, None] == first + tl.arange(0, OTHERS)[None, :]
            squared += tl.sum(products * times_ones(coefficients, one_hot, PRECISION), axis=1)
        else:
            squared += tl.sum(products * coefficients, axis=1)
    inverse = tl.where(squared > 0, 1.0 / tl.sqrt(tl.maximum(squared, TINY)), 0.0)
    for first in range(0, n_columns, COLUMNS):
        found = times_table(
            coefficients, tables, level, n_levels, n_atoms, n_columns, first, COLUMNS, PRECISION
        )
        found *= inverse[:, None]
        column = first + tl.arange(0, COLUMNS)
        if PIXELS_LAST:
            place = (level.to(tl.int64) * n_columns + column)[None, :] * pixels + pixel[:, None]
        else:
            place = (level.to(tl.int64) * pixels + pixel)[:, None] * n_columns + column[None, :]
        tl.store(out + place, found, mask=inside[:, None] & (column < n_columns)[None, :])


@triton.jit
def times_table(
    coefficients,  # [P, L]
    table,  # [S, L, C] float32 or [2, S, L, C] float16
    level,
    n_levels,
    n_atoms,
    n_columns,
    first,
    COLUMNS: tl.constexpr,
    PRECISION: tl.constexpr,
):
    """[P, COLUMNS] coefficients times the columns from ``first`` on of a level of a table."""
    nothing = tl.zeros([coefficients.shape[0], COLUMNS], tl.float32)
    atom, column = tl.arange(0, coefficients.shape[1]), first + tl.arange(0, COLUMNS)
    there = (atom < n_atoms)[:, None] & (column < n_columns)[None, :]
    part = table + (level.to(tl.int64) * n_atoms + atom[:, None]) * n_columns + column[None, :]
    if PRECISION == "fp16x3":
        high, low = halves(coefficients)
        other_high = tl.load(part, mask=there, other=0.0)
        other_low = tl.load(part + n_levels.to(tl.int64) * n_atoms * n_columns, mask=there, other=0.0)
        small = tl.dot(high, other_low, nothing)
        small = tl.dot(low, other_high, small)
        found = tl.dot(high, other_high, small * (1.0 / LOW_SCALE))
    else:
        other = tl.load(part, mask=there, other=0.0)
        found = tl.dot(coefficients, other, nothing, input_precision=PRECISION)
    return found


@triton.jit
def times_ones(coefficients, ones, PRECISION: tl.constexpr):
    """Coefficients times zeros and ones: no digit of these is lost."""
    if PRECISION == "fp16x3":
        high, low = halves(coefficients)
        small = tl.dot(low, ones.to(tl.float16))
        found = tl.dot(high, ones.to(tl.float16), small * (1.0 / LOW_SCALE))
    else:
        found = tl.dot(coefficients, ones.to(tl.float32), input_precision=PRECISION)
    return found
