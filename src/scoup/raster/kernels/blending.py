"""Who paints how much of each pixel: a block of pixels and a chunk of Gaussians at a time, front to back.

The blending weights of G Gaussians at P pixels are a matrix E [P, G]; what follows is one matrix product: rendering is
E @ values, region sums are E^T @ one-hot(regions). The transmittance behind each Gaussian of a chunk is a running
product along its row. A pixel stops before the Gaussian that would take its transmittance below the bound; since
transmittance only falls, that one and all behind it are the ones masked.
"""

# pyright: reportArgumentType=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false

from __future__ import annotations

import triton
import triton.language as tl

from scoup.raster import presets

ALPHA_MIN = tl.constexpr(presets.ALPHA_MIN)
LOW_SCALE = tl.constexpr(2048.0)
# float16 holds no numbers between multiples of 2^-24, and the weight of a Gaussian that is all but hidden is 4e-7.
# Times this, every weight keeps its digits, and the largest is far from overflowing.
WEIGHT_SCALE = tl.constexpr(4096.0)


@triton.jit
def pixel_block(tile, part, across, width, height, TILE: tl.constexpr, PIXELS: tl.constexpr):
    """Pixels of a part of a tile: x and y [P] float32 from the tile's first pixel, their number in the image
    [P] int32, and whether they are inside it [P].
    """
    pixel = part * PIXELS + tl.arange(0, PIXELS)
    x, y = pixel % TILE, pixel // TILE
    column, row = tile % across * TILE + x, tile // across * TILE + y
    inside = (column < width) & (row < height)
    return x.to(tl.float32), y.to(tl.float32), row * width + column, inside


@triton.jit
def load_chunk(pair_ids, corners, records, start, end, CHUNK: tl.constexpr):
    """Gaussians ``start`` to ``start + CHUNK`` of a tile's list, [G] each; beyond ``end`` they paint nothing.

    A Gaussian's record is (ku, skew, kv, peak) and its corner in this tile (u, v), with which its alpha at the pixel
    (x, y) of the tile is 2^(peak - (u + ku x - skew y)^2 - (v + kv y)^2).
    """
    pair = start + tl.arange(0, CHUNK)
    there = pair < end
    gaussian = tl.load(pair_ids + pair, mask=there, other=0)
    u = tl.load(corners + 2 * pair, mask=there, other=0.0)
    v = tl.load(corners + 2 * pair + 1, mask=there, other=0.0)
    record = records + 4 * gaussian.to(tl.int64)
    ku = tl.load(record, mask=there, other=0.0)
    skew = tl.load(record + 1, mask=there, other=0.0)
    kv = tl.load(record + 2, mask=there, other=0.0)
    peak = tl.load(record + 3, mask=there, other=-float("inf"))
    return gaussian, u, v, ku, skew, kv, peak


@triton.jit
def blend(
    x,  # [P]
    y,  # [P]
    u,  # [G]
    v,  # [G]
    ku,  # [G]
    skew,  # [G]
    kv,  # [G]
    peak,  # [G]
    transmittance,  # [P]
    alpha_max,
    stop,
    STOP_INCLUSIVE: tl.constexpr,
):
    """Blending weights [P, G] of a chunk, and the transmittance behind it [P], 0 once a pixel has stopped."""
    along = u[None, :] + ku[None, :] * x[:, None] - skew[None, :] * y[:, None]
    down = v[None, :] + kv[None, :] * y[:, None]
    alpha = tl.exp2(peak[None, :] - down * down - along * along)
    alpha = tl.minimum(alpha, alpha_max)
    alpha = tl.where(alpha >= ALPHA_MIN, alpha, 0.0)
    left = 1.0 - alpha
    after = tl.cumprod(left, axis=1) * transmittance[:, None]
    if STOP_INCLUSIVE:
        kept = after > stop
    else:
        kept = after >= stop
    # alpha (transmittance before): what is left behind it, divided by what it lets through, at least 0.01.
    weights = tl.where(kept, after * (alpha / left), 0.0)
    return weights, tl.min(tl.where(kept, after, 0.0), axis=1)


@triton.jit
def product(one, other, sums, PRECISION: tl.constexpr):
    """``sums`` [M, N] + one [M, K] @ other [K, N]. For "fp16x3" no entry may be beyond some thousands; what is lost of
    each is about 2^-22 of it, or 2^-36 where that is more, see ``WEIGHT_SCALE``.
    """
    if PRECISION == "fp16x3":
        high, low = halves(one)
        other_high, other_low = halves(other)
        small = tl.dot(high, other_low)
        small = tl.dot(low, other_high, small)
        sums = tl.dot(high, other_high, sums + small * (1.0 / LOW_SCALE))
    else:
        sums = tl.dot(one, other, sums, input_precision=PRECISION)
    return sums


@triton.jit
def product_with_ones(one, ones, sums, PRECISION: tl.constexpr):
    """``product`` where the other factor holds zeros and ones only: no bits of it can be lost."""
    if PRECISION == "fp16x3":
        high, low = halves(one)
        small = tl.dot(low, ones.to(tl.float16))
        sums = tl.dot(high, ones.to(tl.float16), sums + small * (1.0 / LOW_SCALE))
    else:
        sums = tl.dot(one, ones.to(tl.float32), sums, input_precision=PRECISION)
    return sums


@triton.jit
def halves(values):
    """float32 as a sum of two float16: high + low / LOW_SCALE. Scaled, because the small ones lose bits."""
    high = values.to(tl.float16)
    return high, ((values - high.to(tl.float32)) * LOW_SCALE).to(tl.float16)
