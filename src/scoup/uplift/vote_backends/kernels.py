"""The sums of the vote on a GPU: one program per Gaussian and level reads its entries.

No two programs write to the same sums, and the order of the additions is fixed: same input, same bytes.
"""

# pyright: reportArgumentType=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false, reportPossiblyUnboundVariable=false

from __future__ import annotations

import triton
import triton.language as tl

from scoup.uplift import constants

LEAST_FACTOR = tl.constexpr(constants.LEAST_FACTOR)


@triton.jit(do_not_specialize=["n_levels", "n_atoms"])
def vote_kernel(
    starts,  # [n + 1] int64: first entry of each Gaussian
    combinations,  # [E] int32
    shares,  # [E] float32: blending weights of the Gaussian in the label tuple
    rows,  # [C, S] int32: of the regions in the tables of codes, -1 for none
    atoms,  # [R, K] int32
    weights,  # [R, K] float32
    inverse_norms,  # [R] float32: of the decoded codes, 0 where one decodes to zero
    grams,  # [S, L, L] float32
    earlier_atoms,  # [n, S, EARLIER_K] int32
    earlier_weights,  # [n, S, EARLIER_K] float32
    sharpness,  # [S] float32
    out,  # [n, S, L] float32: the sums; with KEEP the largest of them, [n, S, KEEP]
    kept,  # with KEEP their atoms, [n, S, KEEP] int32
    n_levels,
    n_atoms,
    K: tl.constexpr,
    EARLIER_K: tl.constexpr,
    KEEP: tl.constexpr,
    ATOMS: tl.constexpr,
    ENTRIES: tl.constexpr,
):
    """Add up ENTRIES at a time. The earlier round is not read where EARLIER_K is 0; KEEP of 0 stores all sums."""
    gaussian, level = tl.program_id(0), tl.program_id(1)
    pair = gaussian.to(tl.int64) * n_levels + level
    atom = tl.arange(0, ATOMS)
    if EARLIER_K > 0:
        products, total = products_with_earlier(
            pair, level, atom, grams, earlier_atoms, earlier_weights, n_atoms, EARLIER_K, ATOMS
        )
        strictness = tl.load(sharpness + level)
    sums = tl.zeros([ATOMS], tl.float32)
    first, end = tl.load(starts + gaussian), tl.load(starts + gaussian + 1)
    while first < end:
        entry = first + tl.arange(0, ENTRIES)
        there = entry < end
        combination = tl.load(combinations + entry, mask=there, other=0).to(tl.int64)
        share = tl.load(shares + entry, mask=there, other=0.0)
        row = tl.load(rows + combination * n_levels + level, mask=there, other=-1).to(tl.int64)
        codes = dense_codes(row, atom, atoms, weights, K, ATOMS, ENTRIES)
        if EARLIER_K > 0:
            inverse_norm = tl.load(inverse_norms + row, mask=row >= 0, other=0.0)
            cosine = tl.sum(codes * products[None, :], axis=1) * inverse_norm
            # A Gaussian without a code counts all regions alike.
            cosine = tl.where(total > 0, tl.minimum(cosine, 1.0), 1.0)
            share *= tl.maximum(tl.exp(strictness * (cosine - 1.0)), LEAST_FACTOR)
        sums += tl.sum(codes * share[:, None], axis=0)
        first += ENTRIES
    if KEEP == 0:
        tl.store(out + pair * n_atoms + atom, sums, mask=atom < n_atoms)
    for slot in range(KEEP):
        largest = tl.max(sums, axis=0)
        best = tl.min(tl.where(sums == largest, atom, ATOMS), axis=0)  # of equal ones the first
        tl.store(out + pair * KEEP + slot, tl.maximum(largest, 0.0))
        tl.store(kept + pair * KEEP + slot, tl.where(largest > 0, best, 0))
        sums = tl.where(atom == best, -1.0, sums)


@triton.jit
def products_with_earlier(
    pair,
    level,
    atom,  # [ATOMS]
    grams,
    earlier_atoms,
    earlier_weights,
    n_atoms,
    EARLIER_K: tl.constexpr,
    ATOMS: tl.constexpr,
):
    """Return products [ATOMS] of all atoms with the Gaussian's decoded earlier code, and the sum of its weights."""
    products = tl.zeros([ATOMS], tl.float32)
    total = 0.0
    gram = grams + level.to(tl.int64) * n_atoms * n_atoms
    for slot in range(EARLIER_K):
        weight = tl.load(earlier_weights + pair * EARLIER_K + slot)
        earlier = tl.load(earlier_atoms + pair * EARLIER_K + slot).to(tl.int64)
        products += weight * tl.load(gram + earlier * n_atoms + atom, mask=atom < n_atoms, other=0.0)
        total += weight
    return products, total


@triton.jit
def dense_codes(
    row,  # [ENTRIES] int64, -1 for no region
    atom,  # [ATOMS]
    atoms,
    weights,
    K: tl.constexpr,
    ATOMS: tl.constexpr,
    ENTRIES: tl.constexpr,
):
    """Return [ENTRIES, ATOMS] codes of regions."""
    dense = tl.zeros([ENTRIES, ATOMS], tl.float32)
    for slot in range(K):
        index = tl.load(atoms + row * K + slot, mask=row >= 0, other=0)
        weight = tl.load(weights + row * K + slot, mask=row >= 0, other=0.0)
        dense += tl.where(index[:, None] == atom[None, :], weight[:, None], 0.0)
    return dense
