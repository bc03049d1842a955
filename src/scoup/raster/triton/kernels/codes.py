"""Rendering of sparse codes: they are packed, made dense where they are used, and multiplied with E."""

# pyright: reportArgumentType=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false, reportAssignmentType=false

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

SLOTS = tl.constexpr(4)  # entries of a code that are read at once: 16 bytes


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
    float32 below 32. What has no such atom is 0, which contributes nothing. An atom that a code has twice gets both
    weights at its first place, even where it has none there.
    """
    row = tl.program_id(0).to(tl.int64) * BLOCK + tl.arange(0, BLOCK)
    there = row < n_codes
    for slot in tl.static_range(GROUPS * SLOTS):
        word = tl.zeros([BLOCK], words.dtype.element_ty)
        if slot < K:
            atom = tl.load(indices + row * K + slot, mask=there, other=0).to(tl.int32)
            total = tl.zeros([BLOCK], tl.float32)
            is_first = there & (atom >= 0) & (atom < n_atoms)
            for other in range(K):
                same = tl.load(indices + row * K + other, mask=there, other=0).to(tl.int32) == atom
                weight = tl.load(weights + row * K + other, mask=there, other=0.0).to(tl.float32)
                total += tl.where(same, weight, 0.0)
                is_first &= (same == 0) | (other >= slot)
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
    words,
    numbers,
    start,
    end,
    level,
    n_levels,
    LEVELS: tl.constexpr,
    GROUPS: tl.constexpr,
    CHUNK: tl.constexpr,
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
def add_codes(
    sums,
    blending,
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
    PRECISION: tl.constexpr,
):
    """``sums`` [P, L] + blending weights [G, P] times the ``dense_codes`` [G, L] of a level."""
    dense = dense_codes(
        words, all_words, numbers, start, end, level, n_levels, first_atom, CHUNK, GROUPS, ATOMS, WIDE
    )
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
    # Each tile has a first chunk, even an empty one: without a way around the loop ptxas 12.8 (Triton 3.4 to 3.6) does
    # not lose the registers that matrix products behind it take descriptors from (tests/machine_code.py).
    going = tl.full([], 1, tl.int32)
    while going != 0:
        # Prefetch the codes of the next chunk while this one is blended.
        next_0, next_1, next_2, next_3 = first_words(
            words, numbers, start + CHUNK, end, level, n_levels, LEVELS, GROUPS, CHUNK
        )
        blending, transmittance = blend(
            records, start, end, x, y, transmittance, alpha_max, stop, STOP_INCLUSIVE, CHUNK, WEIGHT_SCALE
        )
        sums_0 = add_codes(
            sums_0, blending, words_0, words, numbers, start, end, level, n_levels, first_atom, CHUNK, GROUPS,
            ATOMS, WIDE, PRECISION,
        )  # fmt: skip
        if LEVELS > 1:
            sums_1 = add_codes(
                sums_1, blending, words_1, words, numbers, start, end, level + 1, n_levels, first_atom, CHUNK, GROUPS,
                ATOMS, WIDE, PRECISION,
            )  # fmt: skip
        if LEVELS > 2:
            sums_2 = add_codes(
                sums_2, blending, words_2, words, numbers, start, end, level + 2, n_levels, first_atom, CHUNK, GROUPS,
                ATOMS, WIDE, PRECISION,
            )  # fmt: skip
        if LEVELS > 3:
            sums_3 = add_codes(
                sums_3, blending, words_3, words, numbers, start, end, level + 3, n_levels, first_atom, CHUNK, GROUPS,
                ATOMS, WIDE, PRECISION,
            )  # fmt: skip
        start += CHUNK
        going = tl.where(is_lit(transmittance) & (start < end), going, 0)
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
    target = out + first_level * plane + pixel.to(tl.int64)[:, None] * n_atoms + atom[None, :]
    tl.store(target, sums_0 * (1.0 / WEIGHT_SCALE), mask=stored)
    if LEVELS > 1:
        tl.store(target + plane, sums_1 * (1.0 / WEIGHT_SCALE), mask=stored)
    if LEVELS > 2:
        tl.store(target + 2 * plane, sums_2 * (1.0 / WEIGHT_SCALE), mask=stored)
    if LEVELS > 3:
        tl.store(target + 3 * plane, sums_3 * (1.0 / WEIGHT_SCALE), mask=stored)
