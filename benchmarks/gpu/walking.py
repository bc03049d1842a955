"""How far the kernels walk down the tiles' lists, and how many of the lanes on the way paint."""

# pyright: reportArgumentType=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false

from __future__ import annotations

from dataclasses import dataclass

import torch
import triton
import triton.language as tl
from torch import Tensor

from scoup.raster.triton.kernels.blending import blend, is_lit, pixels_of
from scoup.raster.triton.projection import FUSED, TILE, TritonProjection


@dataclass(frozen=True, eq=False)
class Walk:
    """Of kernels whose programs blend a tile, so many Gaussians at a time.

    Attributes:
        chunk: as said.
        chunks: [tiles] int32, chunks each program blends until all its pixels have stopped.
        painting: lanes (a pixel and a Gaussian) with a blending weight.
    """

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
        return self.n_chunks * self.chunk * TILE * TILE


def walk(view: TritonProjection, chunk: int) -> Walk:
    """Walk as the kernels do and count."""
    chunks, painting = (torch.zeros(view.n_tiles, dtype=torch.int32, device=view.device) for _ in range(2))
    with torch.cuda.device_of(chunks):
        walk_kernel[(view.n_tiles,)](
            view.records, view.starts, chunks, painting, view.width, view.height, view.across,
            view.preset.alpha_max, view.preset.stop, STOP_INCLUSIVE=view.preset.stop_inclusive, TILE=TILE,
            CHUNK=chunk, **FUSED,
        )  # fmt: skip
    return Walk(chunk, chunks, int(painting.sum()))


@triton.jit(do_not_specialize=["width", "height", "across"])
def walk_kernel(
    records,
    starts,
    chunks,  # [tiles] int32: out
    painting,  # [tiles] int32: out
    width,
    height,
    across,
    alpha_max,
    stop,
    STOP_INCLUSIVE: tl.constexpr,
    TILE: tl.constexpr,
    CHUNK: tl.constexpr,
):
    tile = tl.program_id(0)
    x, y, _pixel, inside = pixels_of(tile, across, width, height, TILE)
    transmittance = tl.where(inside, 1.0, 0.0)[None, :]
    paints = tl.zeros([TILE * TILE], tl.int32)
    walked = 0
    start, end = tl.load(starts + tile), tl.load(starts + tile + 1)
    while start < end:
        weights, transmittance = blend(
            records, start, end, x, y, transmittance, alpha_max, stop, STOP_INCLUSIVE, CHUNK, 1.0
        )
        paints += tl.sum((weights > 0).to(tl.int32), axis=0)
        walked += 1
        start = tl.where(is_lit(transmittance), start + CHUNK, end)
    tl.store(chunks + tile, walked)
    tl.store(painting + tile, tl.sum(paints, axis=0))
