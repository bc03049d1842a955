"""Rendering of dense channels: E^T @ values."""

# pyright: reportArgumentType=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false, reportAssignmentType=false

from __future__ import annotations

import triton
import triton.language as tl

from scoup.raster.triton.kernels.blending import blend, gaussians_of, is_lit, pixels_of


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
        chunk_values = tl.load(rows, mask=there[:, None] & in_range[None, :], other=0.0)
        # Prefetch the next chunk while this one is blended.
        gaussian, there = gaussians_of(numbers, start + CHUNK, end, CHUNK)
        weights, transmittance = blend(
            records, start, end, x, y, transmittance, alpha_max, stop, STOP_INCLUSIVE, CHUNK, 1.0
        )
        sums = tl.dot(tl.trans(weights), chunk_values, sums, input_precision=PRECISION)
        covered += tl.sum(weights, axis=0, keep_dims=True)
        start = tl.where(is_lit(transmittance), start + CHUNK, end)
    out = image + pixel.to(tl.int64)[:, None] * n_channels + channel[None, :]
    tl.store(out, sums, mask=inside[:, None] & in_range[None, :])
    if block == 0:
        tl.store(coverage + pixel[None, :], covered, mask=inside[None, :])
