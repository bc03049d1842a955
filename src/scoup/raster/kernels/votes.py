"""Region sums into accumulators: each Gaussian collects its own from the tiles it reaches, in a fixed order.

No two programs write to the same accumulators, and nothing depends on which runs first: same input, same bytes.
"""

# pyright: reportArgumentType=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false

from __future__ import annotations

import triton
import triton.language as tl

from scoup import agreement

LEAST_AGREEMENT = tl.constexpr(agreement.LEAST_AGREEMENT)


@triton.jit(do_not_specialize=["n_chosen", "n_levels", "n_tiles", "n_atoms"])
def add_few_kernel(
    chosen,  # [M] int64: places of the Gaussians by depth
    ids,  # [.] int64
    firsts,  # [.] int64: first candidate pair of each Gaussian
    tiles,  # [C] int16 or int32
    places,  # [C] int32
    starts,  # [tiles + 1] int64
    n_columns,  # [tiles] int32
    bases,  # [tiles] int64, -1 for tiles whose sums are not at hand
    sums,  # float32, see ``regions.region_sums_kernel``
    first_columns,  # [tiles] int64: where the regions of a tile's columns begin
    column_regions,  # [., S] int32
    first_rows,  # [S] int64: where the regions of a level begin in the tables
    atoms,  # [R, K] int32
    weights,  # [R, K] float32
    earlier_atoms,  # [N, S, EARLIER_K] unsigned
    earlier_weights,  # [N, S, EARLIER_K] float32
    region_cosines,  # [R, L] float32
    sharpness,  # [S] float32
    out,  # [N, S, L] float32: added to
    n_chosen,
    n_levels,
    n_tiles,
    n_atoms,
    K: tl.constexpr,
    EARLIER_K: tl.constexpr,
    BLOCK: tl.constexpr,
):
    """One lane a Gaussian, for those that reach few tiles; pairs in the same region one after another are summed up
    before their code is added. The earlier round is not read where EARLIER_K is 0.
    """
    lane = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    level = tl.program_id(1)
    there = lane < n_chosen
    place = tl.load(chosen + lane, mask=there, other=0)
    gaussian = tl.load(ids + place, mask=there, other=0)
    pair = tl.load(firsts + place, mask=there, other=0)
    end = tl.load(firsts + place + 1, mask=there, other=0)
    first_row = tl.load(first_rows + level)
    column = tl.zeros([BLOCK], tl.int32)
    region = tl.full([BLOCK], -1, tl.int32)
    total = tl.zeros([BLOCK], tl.float32)
    active = there & (pair < end)
    while tl.max(active.to(tl.int32), axis=0) > 0:
        tile = tl.load(tiles + pair, mask=active, other=0).to(tl.int64)
        real = active & (tile < n_tiles)
        base = tl.load(bases + tile, mask=real, other=-1)
        real = real & (base >= 0)
        count = tl.load(n_columns + tile, mask=real, other=0)
        at = tl.load(places + pair, mask=real, other=0) - tl.load(starts + tile, mask=real, other=0)
        shown = real & (column < count)
        value = tl.load(sums + base + at * count + column, mask=shown, other=0.0)
        regions = column_regions + (tl.load(first_columns + tile, mask=real, other=0) + column) * n_levels
        found = tl.load(regions + level, mask=shown & (value > 0), other=-1)
        another = (found >= 0) & (found != region)
        done = another & (region >= 0)
        if tl.max(done.to(tl.int32), axis=0) > 0:
            add_code(
                gaussian, level, first_row + region, total, done, atoms, weights, earlier_atoms, earlier_weights,
                region_cosines, sharpness, out, n_levels, n_atoms, K, EARLIER_K,
            )  # fmt: skip
        total = tl.where(another, value, tl.where(found >= 0, total + value, total))
        region = tl.where(another, found, region)
        column += 1
        leaves = column >= count
        pair = tl.where(active & leaves, pair + 1, pair)
        column = tl.where(leaves, 0, column)
        active = there & (pair < end)
    add_code(
        gaussian, level, first_row + region, total, region >= 0, atoms, weights, earlier_atoms, earlier_weights,
        region_cosines, sharpness, out, n_levels, n_atoms, K, EARLIER_K,
    )  # fmt: skip


@triton.jit
def add_code(
    gaussian,  # [B] int64
    level,
    row,  # [B] int64: of the region in the tables
    total,  # [B]
    chosen,  # [B]
    atoms,
    weights,
    earlier_atoms,
    earlier_weights,
    region_cosines,
    sharpness,
    out,
    n_levels,
    n_atoms,
    K: tl.constexpr,
    EARLIER_K: tl.constexpr,
):
    """Add the codes of regions, times what each Gaussian paints of its own, where ``chosen``."""
    own = gaussian * n_levels + level
    if EARLIER_K > 0:
        total *= agreement_of(
            own,
            level,
            row,
            chosen,
            earlier_atoms,
            earlier_weights,
            region_cosines,
            sharpness,
            n_atoms,
            EARLIER_K,
        )
    for slot in range(K):
        atom = tl.load(atoms + row * K + slot, mask=chosen, other=0)
        weight = tl.load(weights + row * K + slot, mask=chosen, other=0.0)
        # Lanes have accumulators of their own; "atomic" only keeps what one lane adds in its order.
        tl.atomic_add(out + own * n_atoms + atom, total * weight, mask=chosen & (weight != 0), sem="relaxed")


@triton.jit
def agreement_of(
    own,
    level,
    row,
    chosen,
    earlier_atoms,
    earlier_weights,
    region_cosines,
    sharpness,
    n_atoms,
    EARLIER_K: tl.constexpr,
):
    """What a region counts for a Gaussian after an earlier round: ``Agreement.factors``. Any shape."""
    cosine = tl.zeros(row.shape, tl.float32)
    total = tl.zeros(row.shape, tl.float32)
    for slot in range(EARLIER_K):
        atom = tl.load(earlier_atoms + own * EARLIER_K + slot, mask=chosen, other=0).to(tl.int64)
        weight = tl.load(earlier_weights + own * EARLIER_K + slot, mask=chosen, other=0.0)
        cosine += weight * tl.load(region_cosines + row * n_atoms + atom, mask=chosen, other=0.0)
        total += weight
    cosine = tl.where(total > 0, cosine, 1.0)
    strictness = tl.load(sharpness + level)
    return tl.maximum(tl.exp(strictness * tl.minimum(cosine - 1.0, 0.0)), LEAST_AGREEMENT)


@triton.jit(do_not_specialize=["n_levels", "n_tiles", "n_atoms"])
def add_many_kernel(
    chosen,  # [M] int64: places of the Gaussians by depth
    ids,
    firsts,
    tiles,
    places,
    starts,
    n_columns,
    bases,
    sums,
    first_columns,
    column_regions,
    first_rows,
    atoms,
    weights,
    earlier_atoms,
    earlier_weights,
    region_cosines,
    sharpness,
    out,
    n_levels,
    n_tiles,
    n_atoms,
    K: tl.constexpr,
    EARLIER_K: tl.constexpr,
    PAIRS: tl.constexpr,
    ATOMS: tl.constexpr,
):
    """One program a Gaussian and level, for those that reach many tiles: PAIRS of them at a time. Arguments as of
    ``add_few_kernel``.
    """
    place = tl.load(chosen + tl.program_id(0))
    level = tl.program_id(1)
    gaussian = tl.load(ids + place)
    own = gaussian * n_levels + level
    first, end = tl.load(firsts + place), tl.load(firsts + place + 1)
    first_row = tl.load(first_rows + level)
    atom_range = tl.arange(0, ATOMS)
    added = tl.zeros([ATOMS], tl.float32)
    while first < end:
        pair = first + tl.arange(0, PAIRS)
        tile = tl.load(tiles + pair, mask=pair < end, other=0).to(tl.int64)
        real = (pair < end) & (tile < n_tiles)
        base = tl.load(bases + tile, mask=real, other=-1)
        real = real & (base >= 0)
        count = tl.load(n_columns + tile, mask=real, other=0)
        at = tl.load(places + pair, mask=real, other=0) - tl.load(starts + tile, mask=real, other=0)
        first_column = tl.load(first_columns + tile, mask=real, other=0)
        most = tl.max(count, axis=0)
        for column in range(most):
            shown = real & (column < count)
            value = tl.load(sums + base + at * count + column, mask=shown, other=0.0)
            regions = column_regions + (first_column + column) * n_levels
            region = tl.load(regions + level, mask=shown & (value > 0), other=-1)
            counted = region >= 0
            row = first_row + region
            if EARLIER_K > 0:
                value *= agreement_of(
                    tl.zeros([PAIRS], tl.int64) + own, level, row, counted, earlier_atoms, earlier_weights,
                    region_cosines, sharpness, n_atoms, EARLIER_K,
                )  # fmt: skip
            for slot in range(K):
                atom = tl.load(atoms + row * K + slot, mask=counted, other=-1)
                weight = tl.load(weights + row * K + slot, mask=counted, other=0.0)
                share = tl.where(atom[:, None] == atom_range[None, :], (value * weight)[:, None], 0.0)
                added += tl.sum(share, axis=0)
        first += PAIRS
    accumulators = out + own * n_atoms + atom_range
    stored = atom_range < n_atoms
    tl.store(accumulators, tl.load(accumulators, mask=stored, other=0.0) + added, mask=stored)
