"""How far the kernels walk down the tiles' lists, and how many of the lanes on the way paint."""

# pyright: reportArgumentType=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false

from __future__ import annotations

from dataclasses import dataclass

import torch
import triton
import triton.language as tl
from torch import Tensor

from scoup.raster.gpu_view import FUSED, TILE, GpuView
from scoup.raster.kernels.blending import blend, load_chunk, pixel_block


@dataclass(frozen=True, eq=False)
class Walk:
    """Of kernels whose programs blend so many pixels of a tile, so many Gaussians at a time.

    Attributes:
        pixels, chunk: as said.
        chunks: [tiles, parts] int32, chunks each program blends until all its pixels have stopped.
        painting: lanes (a pixel and a Gaussian) with a blending weight.
    """

    pixels: int
    chunk: int
    chunks: Tensor
    painting: int

    @property
    def n_chunks(self) -> int:
        """Of all programs."""
        return int(self.chunks.sum())

    @property
    def lanes(self) -> int:
        """Pixels x Gaussians evaluated, those that paint nothing included."""
        return self.n_chunks * self.chunk * self.pixels


def walk(view: GpuView, pixels: int, chunk: int) -> Walk:
    """Walk as the kernels do and count."""
    parts = TILE * TILE // pixels
    chunks, painting = (
        torch.zeros(view.n_tiles, parts, dtype=torch.int32, device=view.device) for _ in range(2)
    )
    with torch.cuda.device_of(chunks):
        walk_kernel[(view.n_tiles * parts,)](
            view.pair_ids, view.corners, view.records, view.starts, chunks, painting, view.width, view.height,
            view.across, view.preset.alpha_max, view.preset.stop, STOP_INCLUSIVE=view.preset.stop_inclusive,
            TILE=TILE, PIXELS=pixels, CHUNK=chunk, **FUSED,
        )  # fmt: skip
    return Walk(pixels, chunk, chunks, int(painting.sum()))


@triton.jit(do_not_specialize=["width", "height", "across"])
def walk_kernel(
    pair_ids,
    corners,
    records,
    starts,
    chunks,  # [tiles, parts] int32: out
    painting,  # [tiles, parts] int32: out
    width,
    height,
    across,
    alpha_max,
    stop,
    STOP_INCLUSIVE: tl.constexpr,
    TILE: tl.constexpr,
    PIXELS: tl.constexpr,
    CHUNK: tl.constexpr,
):
    PARTS: tl.constexpr = TILE * TILE // PIXELS
    program = tl.program_id(0)
    tile = program // PARTS
    x, y, _pixel, inside = pixel_block(tile, program % PARTS, across, width, height, TILE, PIXELS)
    transmittance = tl.where(inside, 1.0, 0.0)
    paints = tl.zeros([PIXELS], tl.int32)
    walked = 0
    start, end = tl.load(starts + tile), tl.load(starts + tile + 1)
    while start < end:
        _gaussian, u, v, ku, skew, kv, peak = load_chunk(pair_ids, corners, records, start, end, CHUNK)
        weights, transmittance = blend(
            x, y, u, v, ku, skew, kv, peak, transmittance, alpha_max, stop, STOP_INCLUSIVE
        )
        paints += tl.sum((weights > 0).to(tl.int32), axis=1)
        walked += 1
        going_on = tl.max(transmittance, axis=0) > 0
        start = tl.where(going_on, start + CHUNK, end)
    tl.store(chunks + program, walked)
    tl.store(painting + program, tl.sum(paints, axis=0))
