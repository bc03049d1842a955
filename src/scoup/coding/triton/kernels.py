"""The exact coder as one Triton kernel: each program codes a few rows from their similarities, from start to end.

``reference`` states what is computed. Here it is in float32, and differently in one respect: with T the inverse
of the Cholesky factor of a support's Gram matrix G_S, everything follows from T. The least-squares weights of the
support are T^T T s_S, the directions of its atoms, made orthogonal one after another, have the inner products T G_S:
with all atoms, and what these leave of an atom's squared norm and of the row's similarity to it are sums over them.
Atoms that depend on those before them have a row of zeros in T, and so do slots that are not used.

Shapes: B rows of a program, K slots padded to a power of two, L atoms padded to a power of two. A tensor [B, K, L] is
the largest thing held, and it stays in registers.
"""

# Triton's annotations are for its own compiler: to it a tensor may be indexed with None, and is no tuple.
# pyright: reportArgumentType=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false

from __future__ import annotations

import triton
import triton.language as tl

from scoup.coding import least_squares as plain
from scoup.coding import reference

DEPENDENT = tl.constexpr(plain.DEPENDENT)
NO_GAIN = tl.constexpr(reference.NO_GAIN)
SWAP_GAIN = tl.constexpr(reference.SWAP_GAIN)
NO_WEIGHT = tl.constexpr(plain.NO_WEIGHT)
TINY = tl.constexpr(1e-30)  # in place of zero divisors whose quotients are not used


# One compilation serves batches and whole sets of rows, and any number of passes.
@triton.jit(do_not_specialize=["n_rows", "swap_passes"])
def code_kernel(
    similarities,  # [n, L] float32
    gram,  # [L, L] float32
    norms,  # [L] float32, the diagonal of gram
    warm,  # [n, K] int32 supports to start from; not read unless WARM
    support_out,  # [n, K] int32
    weights_out,  # [n, K] float32
    cosines_out,  # [n] float32
    n_rows,
    n_atoms,
    swap_passes,
    K: tl.constexpr,
    PADDED_K: tl.constexpr,
    PADDED_ATOMS: tl.constexpr,
    BLOCK_ROWS: tl.constexpr,
    WARM: tl.constexpr,
):
    rows = tl.program_id(0) * BLOCK_ROWS + tl.arange(0, BLOCK_ROWS)
    in_range = rows < n_rows
    # Numbers of similarities may exceed 31 bits.
    own_similarities = similarities + rows.to(tl.int64) * n_atoms
    slots = tl.arange(0, PADDED_K)
    own_slots = rows.to(tl.int64)[:, None] * K

    if WARM:
        there = in_range[:, None] & (slots < K)[None, :]
        support = tl.load(warm + own_slots + slots[None, :], mask=there, other=-1)
    else:
        support = choose(
            own_similarities, gram, norms, in_range, n_atoms, K, PADDED_K, PADDED_ATOMS, BLOCK_ROWS
        )
    support, weights, explained = solve(support, own_similarities, gram, n_atoms, K)

    passes = swap_passes
    while passes > 0:
        before = explained
        for slot in range(K):
            support, weights, explained = swap(
                slot,
                support,
                weights,
                explained,
                own_similarities,
                gram,
                norms,
                in_range,
                n_atoms,
                K,
                PADDED_ATOMS,
            )
        changed = tl.max((explained > before).to(tl.int32), axis=0)
        passes = tl.where(changed > 0, passes - 1, 0)

    # The place of each slot by falling weight, the first of equals first.
    heavier = weights[:, None, :] > weights[:, :, None]
    equal = weights[:, None, :] == weights[:, :, None]
    earlier = slots[None, None, :] < slots[None, :, None]
    place = tl.sum((heavier | (equal & earlier)).to(tl.int32), axis=2)
    stored = in_range[:, None] & (place < K)
    tl.store(support_out + own_slots + place, support, mask=stored)
    tl.store(weights_out + own_slots + place, weights, mask=stored)
    tl.store(cosines_out + rows, tl.sqrt(tl.maximum(explained, 0.0)), mask=in_range)


@triton.jit
def choose(
    own_similarities,  # [B] pointers
    gram,
    norms,
    in_range,  # [B]
    n_atoms,
    K: tl.constexpr,
    PADDED_K: tl.constexpr,
    PADDED_ATOMS: tl.constexpr,
    BLOCK_ROWS: tl.constexpr,
):
    """[B, K] supports by greedy orthogonal least squares with positive residuals only, -1 once no atom helps."""
    slots = tl.arange(0, PADDED_K)
    atoms = tl.arange(0, PADDED_ATOMS)
    residual = load_similarities(own_similarities, atoms, in_range, n_atoms)
    squares = tl.load(norms + atoms, mask=atoms < n_atoms, other=0.0)[None, :]
    left = squares + tl.zeros_like(residual)
    directions = tl.zeros([BLOCK_ROWS, PADDED_K, PADDED_ATOMS], tl.float32)
    support = tl.full([BLOCK_ROWS, PADDED_K], -1, tl.int32)
    enough = tl.zeros([BLOCK_ROWS], tl.float32)
    for step in range(K):
        gain, pick = best_atom(residual, left, squares)
        enough = tl.where(step == 0, NO_GAIN * gain, enough)
        chosen = gain > enough
        picked = atoms[None, :] == pick[:, None]
        along = tl.sum(tl.where(picked[:, None, :], directions, 0.0), axis=2)
        pull = tl.sum(tl.where(picked, residual, 0.0), axis=1)
        rest = tl.sum(tl.where(picked, left, 0.0), axis=1)
        inverse = 1.0 / tl.sqrt(tl.maximum(rest, TINY))
        row = load_gram_rows(gram, pick, chosen, atoms, n_atoms)
        direction = (row - tl.sum(along[:, :, None] * directions, axis=1)) * inverse[:, None]
        direction = tl.where(chosen[:, None], direction, 0.0)
        residual -= (pull * inverse)[:, None] * direction
        left = tl.where(picked & chosen[:, None], 0.0, left - direction * direction)
        directions = tl.where((slots == step)[None, :, None], direction[:, None, :], directions)
        support = tl.where((slots == step)[None, :] & chosen[:, None], pick[:, None], support)
    return support


@triton.jit
def swap(
    slot,
    support,  # [B, K]
    weights,  # [B, K]
    explained,  # [B]
    own_similarities,  # [B] pointers
    gram,
    norms,
    in_range,  # [B]
    n_atoms,
    K: tl.constexpr,
    PADDED_ATOMS: tl.constexpr,
):
    """Exchange the atom of one slot for a better one, where there is one; or fill the first unused slot."""
    slots = tl.arange(0, support.shape[1])
    atoms = tl.arange(0, PADDED_ATOMS)
    stays = (support >= 0) & (slots != slot)[None, :]
    toward, within = gather_problem(support, own_similarities, gram, n_atoms)
    factor = inverse_factor(within, stays, K)
    pulls = tl.sum(factor * toward[:, None, :], axis=2)
    others = tl.sum(factor * pulls[:, :, None], axis=1)  # least-squares weights of the atoms that stay

    # [B, K, L]; a program reads its rows of the Gram matrix again for every slot, from a cache.
    there = stays[:, :, None] & (atoms < n_atoms)[None, None, :]
    rows = tl.load(
        gram + tl.maximum(support, 0)[:, :, None] * n_atoms + atoms[None, None, :], mask=there, other=0.0
    )
    residual = load_similarities(own_similarities, atoms, in_range, n_atoms)
    residual -= tl.sum(others[:, :, None] * rows, axis=1)
    squares = tl.load(norms + atoms, mask=atoms < n_atoms, other=0.0)[None, :]
    left = squares + tl.zeros_like(residual)
    for direction in range(K):
        along = tl.sum(tl.where((slots == direction)[None, :, None], factor, 0.0), axis=1)
        products = tl.sum(along[:, :, None] * rows, axis=1)
        left -= products * products
    gain, pick = best_atom(residual, left, squares)

    # Least squares without signs bounds what the swap can explain.
    enough = explained * (1 + SWAP_GAIN)
    reached = slot <= tl.sum((support >= 0).to(tl.int32), axis=1)
    tries = reached & (gain > 0) & (tl.sum(pulls * pulls, axis=1) + gain > enough)
    if tl.max(tries.to(tl.int32), axis=0) > 0:
        other = tl.where((slots == slot)[None, :], pick[:, None], support)
        other = tl.where(tries[:, None], other, -1)
        other, other_weights, other_explained = solve(other, own_similarities, gram, n_atoms, K)
        better = tries & (other_explained > enough)
        support = tl.where(better[:, None], other, support)
        weights = tl.where(better[:, None], other_weights, weights)
        explained = tl.where(better, other_explained, explained)
    return support, weights, explained


@triton.jit
def solve(support, own_similarities, gram, n_atoms, K: tl.constexpr):
    """Non-negative least squares on the support; atoms without weight are dropped and the others close up. Support,
    weights, w . s.
    """
    toward, within = gather_problem(support, own_similarities, gram, n_atoms)
    weights = nonnegative_least_squares(toward, within, support >= 0, K)
    explained = tl.sum(weights * toward, axis=1)
    used = weights > 0
    slots = tl.arange(0, support.shape[1])
    earlier = slots[None, None, :] < slots[None, :, None]
    place = tl.sum((used[:, None, :] & earlier).to(tl.int32), axis=2)
    comes = used[:, None, :] & (place[:, None, :] == slots[None, :, None])  # [B, to, from]
    support = tl.sum(tl.where(comes, support[:, None, :] + 1, 0), axis=2) - 1
    return support, tl.sum(tl.where(comes, weights[:, None, :], 0.0), axis=2), explained


@triton.jit
def best_atom(residual, left, squares):
    """The gain [B] of the best atom to add and its number [B]; gain 0 if no atom helps."""
    usable = (left > DEPENDENT * squares) & (residual > 0)  # false for NaN
    gains = tl.where(usable, residual * residual / tl.where(usable, left, 1.0), 0.0)
    return tl.max(gains, axis=1, return_indices=True)


@triton.jit
def load_similarities(own_similarities, atoms, in_range, n_atoms):
    """[B, L], zero in place of what is not finite: such a similarity must not draw an atom, nor spread."""
    there = in_range[:, None] & (atoms < n_atoms)[None, :]
    return finite(tl.load(own_similarities[:, None] + atoms[None, :], mask=there, other=0.0))


@triton.jit
def load_gram_rows(gram, picks, used, atoms, n_atoms):
    """[B, L]: the row of the Gram matrix of one atom for each program row, zero where not ``used``."""
    there = used[:, None] & (atoms < n_atoms)[None, :]
    return tl.load(gram + picks[:, None] * n_atoms + atoms[None, :], mask=there, other=0.0)


@triton.jit
def gather_problem(support, own_similarities, gram, n_atoms):
    """Similarities [B, K] and Gram matrix [B, K, K] of a support, zero in slots that are not used."""
    used = support >= 0
    atoms = tl.maximum(support, 0)
    toward = tl.load(own_similarities[:, None] + atoms, mask=used, other=0.0)
    both = used[:, :, None] & used[:, None, :]
    within = tl.load(gram + atoms[:, :, None] * n_atoms + atoms[:, None, :], mask=both, other=0.0)
    return finite(toward), finite(within)


@triton.jit
def finite(values):
    """Zero in place of NaN and infinities."""
    return tl.where(tl.abs(values) < float("inf"), values, 0.0)


@triton.jit
def nonnegative_least_squares(toward, within, valid, K: tl.constexpr):
    """[B, K] the w >= 0 that minimise w^T within w - 2 w . toward, zero outside ``valid`` and for atoms that depend
    on others. See ``reference``.
    """
    norms = diagonal(within)
    alone = tl.where(valid & (norms > 0), toward / tl.maximum(norms, TINY), 0.0)
    smallest = NO_WEIGHT * tl.maximum(tl.max(alone, axis=1), 0.0)
    weights, independent = least_squares(toward, within, valid, K)
    positive = ~valid | (independent & (weights > smallest[:, None]))
    done = tl.min(positive.to(tl.int32), axis=1) > 0
    weights = tl.where(done[:, None], weights, 0.0)
    # Mostly that was all: the atoms were chosen for pulling the row's way.
    if tl.min(done.to(tl.int32), axis=0) == 0:
        weights += active_set(toward, within, valid & ~done[:, None], smallest, K)
    return tl.where(weights > 0, weights, 0.0)


@triton.jit
def active_set(toward, within, valid, smallest, K: tl.constexpr):
    """The method of Lawson and Hanson, every row at its own place in it: each round solves for the atoms in use once,
    then goes to the solution, or as far as weights stay positive; a row at its solution takes in one more atom.
    """
    norms = diagonal(within)
    slots = tl.arange(0, toward.shape[1])[None, :]
    weights = tl.zeros_like(toward)
    barred = ~valid
    enters = entering(toward, norms, barred, smallest, slots)
    used = enters
    rounds = 8 * K  # an atom that was dropped may come back, but not for ever
    while rounds > 0:
        target, independent = least_squares(toward, within, used, K)
        sound = independent & (target > smallest[:, None])
        useless = tl.max((enters & ~sound).to(tl.int32), axis=1) > 0
        out = useless[:, None] & enters
        barred |= out
        used &= ~out

        falls = used & (target <= 0)
        share = tl.where(falls, weights / tl.maximum(weights - target, TINY), 1.0)
        step = tl.min(share, axis=1)
        moved = weights + step[:, None] * (target - weights)
        arrived = tl.max(falls.to(tl.int32), axis=1) == 0
        keeps = used & (arrived[:, None] | (moved > smallest[:, None]))
        stays = useless[:, None]
        weights = tl.where(stays, weights, tl.where(keeps, moved, 0.0))
        used = tl.where(stays, used, keeps)

        rests = arrived | useless
        pull = toward - tl.sum(within * weights[:, None, :], axis=2)
        enters = entering(pull, norms, barred | used, smallest, slots) & rests[:, None]
        used |= enters
        goes_on = ~rests[:, None] | enters
        rounds = tl.where(tl.max(tl.max(goes_on.to(tl.int32), axis=1), axis=0) > 0, rounds - 1, 0)
    return weights


@triton.jit
def entering(pull, norms, barred, smallest, slots):
    """[B, K] true at the atom that lowers the residual fastest, nowhere if none does."""
    helps = ~barred & (pull > smallest[:, None] * norms) & (pull > 0)
    steepest, which = tl.max(tl.where(helps, pull, 0.0), axis=1, return_indices=True)
    return (slots == which[:, None]) & (steepest > 0)[:, None]


@triton.jit
def least_squares(toward, within, active, K: tl.constexpr):
    """Weights [B, K] of the active atoms without regard to sign, and which atoms [B, K] are active and independent of
    those before them; all others get weight 0.
    """
    factor = inverse_factor(within, active, K)
    independent = diagonal(factor) > 0
    weights = apply_inverse(factor, toward)
    # What rounding left over is solved for once more.
    left_over = toward - tl.sum(within * weights[:, None, :], axis=2)
    return weights + apply_inverse(factor, left_over), independent


@triton.jit
def apply_inverse(factor, toward):
    """T^T T toward, [B, K]."""
    return tl.sum(factor * tl.sum(factor * toward[:, None, :], axis=2)[:, :, None], axis=1)


@triton.jit
def inverse_factor(within, active, K: tl.constexpr):
    """T [B, K, K], lower triangular: T within T^T is the identity on the active atoms that do not depend on those
    before them; rows and columns of all others are zero.
    """
    slots = tl.arange(0, within.shape[1])
    factor = tl.zeros_like(within)
    for slot in range(K):
        here = (slots == slot)[None, :]
        products = tl.sum(tl.where(here[:, :, None], within, 0.0), axis=1)
        along = tl.sum(factor * products[:, None, :], axis=2)
        norm = tl.sum(tl.where(here, products, 0.0), axis=1)
        left = norm - tl.sum(along * along, axis=1)
        counts = tl.max((here & active).to(tl.int32), axis=1) > 0
        counts &= left > DEPENDENT * norm
        inverse = tl.where(counts, 1.0 / tl.sqrt(tl.maximum(left, TINY)), 0.0)
        row = tl.where(here, 1.0, 0.0) - tl.sum(factor * along[:, :, None], axis=1)
        factor = tl.where(here[:, :, None], (row * inverse[:, None])[:, None, :], factor)
    return factor


@triton.jit
def diagonal(matrix):
    """[B, K] of [B, K, K]."""
    slots = tl.arange(0, matrix.shape[1])
    return tl.sum(tl.where((slots[:, None] == slots[None, :])[None, :, :], matrix, 0.0), axis=2)
