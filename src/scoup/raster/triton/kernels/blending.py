"""Contributions of Gaussians to pixels: a tile and a chunk of Gaussians at a time, front to back.

The blending weights of G Gaussians at P pixels are a matrix E [G, P]; what follows is one matrix product: rendering is
E^T @ values, region sums are E @ one-hot(regions). The transmittance behind each Gaussian of a chunk is a running
product down its column. A pixel stops before the Gaussian that would take its transmittance below the bound; since
transmittance only falls, that one and all behind it are the ones masked.

These kernels are written for Triton's layouts. A tensor is distributed over threads by its last dimension, so in
[G, P] a thread has a pixel and the whole chunk, and threads exchange nothing for a running product; in [P, G] the same
takes more than twice the instructions. A change of layout goes through shared memory with a barrier before and after,
which costs more than the arithmetic here; so a thread loads its terms of a Gaussian itself, and values carried from
chunk to chunk keep the shape [1, P].
"""

# pyright: reportArgumentType=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false

from __future__ import annotations

import triton
import triton.language as tl

from scoup.raster import presets

RECORD = tl.constexpr(8)
"""Numbers that a tile knows of a Gaussian: u, v, ku, kv; skew, peak, its row in the scene (an int32), 0. Its alpha at
the pixel (x, y) of the tile is 2^(peak - (u + ku x - skew y)^2 - (v + kv y)^2)."""
ROW = tl.constexpr(6)
PADDING = 64  # records behind the last one; a chunk may be read beyond its tile's list
ALPHA_MIN = tl.constexpr(presets.ALPHA_MIN)
LOW_SCALE = tl.constexpr(2048.0)
# The smallest step of float16 is 2^-24, and the weight of a nearly hidden Gaussian is 4e-7. Times this, every weight
# keeps its digits, and the largest, 1, does not overflow.
WEIGHT_SCALE = tl.constexpr(32768.0)


@triton.jit
def pixels_of(tile, across, width, height, TILE: tl.constexpr):
    """Pixels of a tile: x and y [1, P] float32 from its first one, their number in the image [P] int32, and whether
    they are inside it [P].
    """
    pixel = tl.arange(0, TILE * TILE)
    x, y = pixel % TILE, pixel // TILE
    column, row = tile % across * TILE + x, tile // across * TILE + y
    inside = (column < width) & (row < height)
    return x.to(tl.float32)[None, :], y.to(tl.float32)[None, :], row * width + column, inside


@triton.jit
def gaussians_of(numbers, start, end, CHUNK: tl.constexpr):
    """Rows in the scene of the Gaussians ``start`` to ``start + CHUNK`` of a tile's list, and whether they are there,
    [G] each. ``numbers`` are the records as int32.
    """
    lane = tl.arange(0, CHUNK)
    there = lane < end - start
    gaussian = tl.load(numbers + start * RECORD + (lane * RECORD + ROW), mask=there, other=0)
    return gaussian, there


@triton.jit
def blend(
    records,  # [., RECORD] float32
    start,
    end,
    x,  # [1, P]
    y,  # [1, P]
    transmittance,  # [1, P]
    alpha_max,
    stop,
    STOP_INCLUSIVE: tl.constexpr,
    CHUNK: tl.constexpr,
    SCALE: tl.constexpr,
):
    """Blending weights [G, P] of the Gaussians ``start`` to ``start + CHUNK`` of a tile's list, times SCALE, and the
    transmittance behind them [1, P], 0 once a pixel has stopped. Beyond ``end`` nothing contributes.
    """
    u, v, ku, kv, skew, peak = spread(records, start, end, CHUNK, x.shape[1])
    along = u + ku * x - skew * y
    down = v + kv * y
    alpha = tl.exp2(peak - down * down - along * along)
    alpha = tl.minimum(alpha, alpha_max)
    alpha = tl.where(alpha >= ALPHA_MIN, alpha, 0.0)
    through, shares = tl.associative_scan((1.0 - alpha, alpha), 0, one_behind_the_other)
    after = through * transmittance
    last = tl.min(after, axis=0, keep_dims=True)
    shares *= transmittance * SCALE
    if STOP_INCLUSIVE:
        weights = tl.where(after > stop, shares, 0.0)
        last = tl.where(last > stop, last, 0.0)
    else:
        weights = tl.where(after >= stop, shares, 0.0)
        last = tl.where(last >= stop, last, 0.0)
    return weights, last


@triton.jit
def spread(records, start, end, CHUNK: tl.constexpr, PIXELS: tl.constexpr):
    """u, v, ku, kv, skew and peak of a chunk, [G, P] each, the same at all pixels."""
    row = tl.arange(0, CHUNK)
    # Triton lays out a load, and all values computed from it, along the dimension with the longest run of contiguous
    # addresses. Addresses are equal across pixels, so a hint claims runs of two; the width of a load depends on the
    # last dimension alone, with runs of four. The zero must not look constant, or the hint is folded away with the sum.
    nothing = tl.arange(0, PIXELS) // PIXELS
    at = row[:, None, None] * RECORD + tl.arange(0, 4)[None, None, :] + nothing[None, :, None]
    first_at = tl.max_contiguous(tl.multiple_of(records + start * RECORD + at, (16, 16, 16)), (1, 2, 4))
    second_at = tl.max_contiguous(
        tl.multiple_of(records + start * RECORD + (at + 4), (16, 16, 16)), (1, 2, 4)
    )
    first = tl.reshape(tl.load(first_at), (CHUNK, PIXELS, 2, 2))
    second = tl.reshape(tl.load(second_at), (CHUNK, PIXELS, 2, 2))
    u_ku, v_kv = tl.split(first)
    u, ku = tl.split(u_ku)
    v, kv = tl.split(v_kv)
    skew_row, peak_0 = tl.split(second)
    skew, _ = tl.split(skew_row)
    peak, _ = tl.split(peak_0)
    # Beyond the list are records of another tile, or zeros: never NaN.
    peak = tl.where((row < end - start)[:, None], peak, -float("inf"))
    return u, v, ku, kv, skew, peak


@triton.jit
def one_behind_the_other(through, share, through_behind, share_behind):
    """Return the transmittance of two groups of Gaussians together, and the hindmost Gaussian's share of the light:
    its alpha times the transmittance of all before it. Associative, and without a division.
    """
    return through * through_behind, through * share_behind


@triton.jit
def is_lit(transmittance):
    """Return whether any pixel goes on."""
    return tl.max(tl.max(transmittance, axis=1), axis=0) > 0


@triton.jit
def halves(values):
    """float32 as a sum of two float16: high + low / LOW_SCALE. Scaled, because the small ones lose bits."""
    high = values.to(tl.float16)
    return high, ((values - high.to(tl.float32)) * LOW_SCALE).to(tl.float16)


@triton.jit
def halves_of_weights(weights):
    """Blending weights times WEIGHT_SCALE as a sum of two float16, high + low: what is lost is 2^-22 of them, or 2^-25
    where that is more.
    """
    high = weights.to(tl.float16)
    return high, (weights - high.to(tl.float32)).to(tl.float16)


@triton.jit
def add_product(high, low, other, sums):
    """``sums`` [M, N] + (high + low) [M, K] @ other [K, N], all of float16: no digit of ``other`` is lost."""
    sums = tl.dot(high, other, sums)
    return tl.dot(low, other, sums)
