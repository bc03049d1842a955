"""The uplift as the paper describes it: every pixel adds its code to every Gaussian that paints it.

One atomic addition for each pixel, Gaussian and entry of the pixel's code, in no fixed order: what summing over regions
first saves. To be compared with, and for nothing else. Imports triton: import this module only where tensors are on a
GPU.
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

from scoup.base.errors import InputError
from scoup.raster.combinations import check_labels
from scoup.raster.triton.kernels.blending import blend, gaussians_of, is_lit, pixels_of
from scoup.raster.triton.projection import FUSED, TILE, TritonProjection
from scoup.scene.codes import SparseCodes

_CHUNK = 16
_WARPS = 2  # a thread a pixel


def scatter_view(view: TritonProjection, labels: Tensor, codes: Sequence[SparseCodes], out: Tensor) -> None:
    """Add a view's codes to sums pixel by pixel: w_i = sum of e_i times the code of each pixel (method.md, stage 2).

    Args:
        view: from ``raster.project`` on a GPU.
        labels: [S, H, W] integer regions, -1 for none.
        codes: one SparseCodes a level, row r for region r, all with as many atoms.
        out: [N, S, L] float32, contiguous, on the view's device; added to in place.

    Raises:
        InputError: shapes disagree.
    """
    expected = (view.n_gaussians, len(codes), codes[0].n_atoms)
    if tuple(out.shape) != expected or not out.is_contiguous() or out.dtype != torch.float32:
        raise InputError(
            f"sums must be contiguous float32 {list(expected)}, not {out.dtype} {list(out.shape)}"
        )
    if tuple(labels.shape) != (len(codes), view.height, view.width):
        raise InputError(
            f"labels {list(labels.shape)} do not fit {len(codes)} levels of {view.height} x {view.width} pixels"
        )
    check_labels(labels)
    labels = labels.to(view.device).long().clamp(min=-1).int().contiguous()
    k = max(level.k for level in codes)
    counts = torch.tensor([len(level) for level in codes])
    first_rows = (counts.cumsum(0) - counts).to(view.device)
    atoms, weights = (
        torch.cat([torch.nn.functional.pad(part, (0, k - part.shape[1])) for part in parts]).to(view.device)
        for parts in ([level.indices.int() for level in codes], [level.weights for level in codes])
    )
    with torch.cuda.device_of(out):
        scatter_kernel[(view.n_tiles,)](
            view.records, view.numbers, view.starts, labels, first_rows, atoms, weights, out,
            view.width, view.height, view.across, len(codes), codes[0].n_atoms, view.preset.alpha_max,
            view.preset.stop, STOP_INCLUSIVE=view.preset.stop_inclusive, TILE=TILE, CHUNK=_CHUNK,
            K=k, num_warps=_WARPS, **FUSED,
        )  # fmt: skip


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
    """One program a tile."""
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
