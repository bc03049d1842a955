"""The uplift as the paper describes it: every pixel adds its code to every Gaussian that contributes to it.

One atomic addition for each pixel, Gaussian and entry of the pixel's code, in no fixed order: what summing over regions
first saves. To be compared with, and for nothing else. Imports triton.
"""

# Triton's annotations are for its own compiler: to it a tensor may be indexed with None, and is no tuple. A launch
# takes plain numbers as constants, and options beside the kernel's arguments.
# pyright: reportArgumentType=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false

from __future__ import annotations

from collections.abc import Sequence

import torch
import triton
import triton.language as tl
from torch import Tensor

from scoup import raster
from scoup.raster.triton.kernels.blending import blend, gaussians_of, is_lit, pixels_of
from scoup.raster.triton.projection import FUSED, TILE, TritonProjection
from scoup.scene.codes import SparseCodes

_CHUNK = 16
_WARPS = 2  # a thread a pixel


def scatter_view(
    projection: raster.Projection, labels: Tensor, codes: Sequence[SparseCodes], out: Tensor | None = None
) -> Tensor:
    """Return a view's codes summed pixel by pixel, w_i = sum of e_i times the code of each pixel (method.md, stage 2).

    ``projection``: from ``raster.project`` on a GPU; ``labels``: [S, H, W] integer regions, -1 for none;
    ``out``: [N, S, L] float32, contiguous, on the same device: added to and returned.
    """
    assert isinstance(projection, TritonProjection)
    preset, shape = projection.preset, (projection.n_gaussians, len(codes), codes[0].n_atoms)
    out = torch.zeros(shape, device=labels.device) if out is None else out
    assert out.shape == shape
    assert labels.shape == (len(codes), projection.height, projection.width)
    labels = labels.to(projection.device).long().clamp(min=-1).int().contiguous()
    k = max(level.k for level in codes)
    counts = torch.tensor([len(level) for level in codes])
    first_rows = (counts.cumsum(0) - counts).to(projection.device)
    atoms, weights = (
        torch.cat([torch.nn.functional.pad(part, (0, k - part.shape[1])) for part in parts]).to(
            projection.device
        )
        for parts in ([level.indices.int() for level in codes], [level.weights for level in codes])
    )
    with torch.cuda.device_of(out):
        scatter_kernel[(projection.n_tiles,)](
            projection.records, projection.numbers, projection.starts, labels, first_rows, atoms, weights, out,
            projection.width, projection.height, projection.across, len(codes), codes[0].n_atoms, preset.alpha_max,
            preset.stop, STOP_INCLUSIVE=preset.stop_inclusive, TILE=TILE, CHUNK=_CHUNK, K=k, num_warps=_WARPS, **FUSED,
        )  # fmt: skip
    return out


@triton.jit(do_not_specialize=["width", "height", "across", "n_levels", "n_atoms"])
def scatter_kernel(
    records,  # [., RECORD] float32
    numbers,  # the same memory as int32
    starts,  # [tiles + 1] int64
    labels,  # [S, H, W] int32
    first_rows,  # [S] int64: where the regions of a level begin in the tables
    atoms,  # [R, K] int32
    weights,  # [R, K] float32
    out,  # [N, S, L] float32: added to
    width,
    height,
    across,
    n_levels,
    n_atoms,
    alpha_max,
    stop,
    STOP_INCLUSIVE: tl.constexpr,
    TILE: tl.constexpr,
    CHUNK: tl.constexpr,
    K: tl.constexpr,
):
    """Run one program per tile."""
    tile = tl.program_id(0)
    x, y, pixel, inside = pixels_of(tile, across, width, height, TILE)
    plane = height.to(tl.int64) * width
    transmittance = tl.where(inside, 1.0, 0.0)[None, :]
    start, end = tl.load(starts + tile), tl.load(starts + tile + 1)
    while start < end:
        gaussian, _ = gaussians_of(numbers, start, end, CHUNK)
        blending, transmittance = blend(
            records, start, end, x, y, transmittance, alpha_max, stop, STOP_INCLUSIVE, CHUNK, 1.0
        )
        for level in range(n_levels):
            region = tl.load(labels + level * plane + pixel, mask=inside, other=-1)
            has_region = region >= 0
            row = (tl.load(first_rows + level) + region) * K
            own = out + (gaussian.to(tl.int64) * n_levels + level) * n_atoms
            for slot in range(K):
                atom = tl.load(atoms + row + slot, mask=has_region, other=0)
                weight = tl.load(weights + row + slot, mask=has_region, other=0.0)
                share = blending * weight[None, :]
                tl.atomic_add(own[:, None] + atom[None, :], share, mask=share > 0, sem="relaxed")
        start = tl.where(is_lit(transmittance), start + CHUNK, end)
