"""A scene as one camera sees it, on a GPU: projected, binned to tiles and sorted by the kernels of ``kernels``."""

# A launch takes plain numbers as constants, and options beside the kernel's arguments.
# pyright: reportArgumentType=false, reportCallIssue=false

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import torch
import triton
from torch import Tensor

from scoup.base import InputError
from scoup.raster.binning import SLACK
from scoup.raster.presets import ALPHA_MIN, LOW_PASS, RasterPreset
from scoup.raster.projection import ray_limits, tile_counts
from scoup.raster.triton.kernels.blending import PADDING, RECORD
from scoup.raster.triton.kernels.projection import (
    GEOMETRY,
    SHAPE,
    TABLE,
    expand_kernel,
    list_kernel,
    project_kernel,
    sieve_kernel,
)
from scoup.scene import Camera, Gaussians

# Of matrix products. "fp16x3" splits float32 into two float16 and multiplies these on tensor cores, where numbers are
# known to fit; "tf32x3" does the same with tf32; "ieee" is plain float32.
Precision = Literal["fp16x3", "tf32x3", "ieee"]

# Fused multiply-add; the default depends on the version of Triton.
FUSED: dict[str, Any] = {"enable_fp_fusion": True}
# Edge of a tile in pixels. With 16, twice as many lanes are wasted, for half as many pairs to sort.
TILE = 8
MOST_PAIRS = 2**31 - 1
_BLOCK = 128


@dataclass(frozen=True, eq=False)
class TritonProjection:
    """A scene as one camera sees it: projected, binned and sorted."""

    n_gaussians: int  # of the scene
    width: int  # pixels
    height: int
    preset: RasterPreset
    # [., RECORD] float32 of the Gaussians that reach each tile, nearest first, see ``kernels.blending``; PADDING more
    # rows at the end.
    records: Tensor
    starts: Tensor  # [tiles + 1] int64, where each tile begins in these

    backend = "triton"

    @property
    def device(self) -> torch.device:
        return self.records.device

    @property
    def numbers(self) -> Tensor:
        """``records`` as int32."""
        return self.records.view(torch.int32)

    @property
    def across(self) -> int:
        """Tiles in a row."""
        return math.ceil(self.width / TILE)

    @property
    def n_tiles(self) -> int:
        return len(self.starts) - 1


def product_precision(wide: bool) -> Precision:
    """Return the precision of products on this GPU; ``wide`` where numbers may be beyond float16.

    AMD's matrix units have no products of split tf32: they multiply float32 as it is.
    """
    if not wide:
        return "fp16x3"
    return "ieee" if torch.version.hip else "tf32x3"


def project(gaussians: Gaussians, camera: Camera, preset: RasterPreset) -> TritonProjection:
    """See ``raster.project``; more pairs of Gaussians and tiles than 31 bits can number raise InputError."""
    device = gaussians.device
    with torch.cuda.device_of(gaussians.means):
        table = camera_table(camera, preset, device)
        scene = [
            tensor.contiguous()
            for tensor in (gaussians.means, gaussians.quats, gaussians.scales, gaussians.opacities)
        ]
        means, _, scales, opacities = scene
        count = len(gaussians)
        keep = torch.empty(count, dtype=torch.int8, device=device)
        if count:
            grid = (triton.cdiv(count, _BLOCK),)
            sieve_kernel[grid](means, scales, opacities, table, keep, count, BLOCK=_BLOCK, **FUSED)
        ids = torch.nonzero(keep).squeeze(1)
        return _bin(gaussians, camera, preset, scene, ids, table)


def _bin(
    gaussians: Gaussians,
    camera: Camera,
    preset: RasterPreset,
    scene: list[Tensor],
    ids: Tensor,  # [M]
    table: Tensor,
) -> TritonProjection:
    device, n_visible = gaussians.device, len(ids)
    across, down = tile_counts(camera.width, camera.height, TILE)
    n_tiles = across * down
    depths = torch.empty(n_visible, dtype=torch.float64, device=device)
    geometry = torch.empty(n_visible, GEOMETRY.value, dtype=torch.float64, device=device)
    shapes = torch.empty(n_visible, SHAPE.value, device=device)
    centres = shapes.view(torch.float64)
    rects = torch.empty(n_visible, 3, dtype=torch.int32, device=device)
    counts = torch.empty(n_visible, dtype=torch.int32, device=device)
    if n_visible:
        grid = (triton.cdiv(n_visible, _BLOCK),)
        project_kernel[grid](
            ids, *scene, table, depths, geometry, shapes, centres, rects, counts, n_visible, across, down,
            TILE=TILE, BLOCK=_BLOCK, **FUSED,
        )  # fmt: skip
    # Equal depths stay in the order of the rows.
    order = torch.sort(depths, stable=True).indices
    firsts = torch.zeros(n_visible + 1, dtype=torch.int64, device=device)
    torch.cumsum(counts[order], 0, out=firsts[1:])
    n_candidates = int(firsts[-1])
    if n_candidates > MOST_PAIRS:
        raise InputError(
            f"an image of {camera.width} x {camera.height} with {n_candidates} pairs of Gaussians and tiles is too "
            "much for one pass; make the images smaller or prune the scene"
        )
    ranks = torch.repeat_interleave(firsts.diff(), output_size=n_candidates)
    # Radix sorts take as many passes as the keys have bytes.
    tile_type = torch.int16 if n_tiles < 2**15 else torch.int32
    tiles = torch.empty(n_candidates, dtype=tile_type, device=device)
    slots = torch.empty(n_candidates, dtype=torch.int32, device=device)
    if n_candidates:
        grid = (triton.cdiv(n_candidates, _BLOCK),)
        expand_kernel[grid](
            ranks, order, firsts, rects, geometry, centres, table, tiles, slots, n_candidates, across, down,
            TILE=TILE, BLOCK=_BLOCK, **FUSED,
        )  # fmt: skip
    # The candidates are in depth order, so a stable sort by tile alone keeps each tile's.
    in_order, by_tile = torch.sort(tiles, stable=True)
    starts = torch.searchsorted(in_order, torch.arange(n_tiles + 1, dtype=tile_type, device=device))
    n_records = n_candidates + PADDING
    records = torch.empty(n_records, RECORD.value, device=device)
    list_kernel[(triton.cdiv(n_records, _BLOCK),)](
        by_tile, in_order, slots, ids, shapes, centres, records, n_candidates, n_records, across, down,
        TILE=TILE, BLOCK=_BLOCK, **FUSED,
    )  # fmt: skip
    return TritonProjection(len(gaussians), camera.width, camera.height, preset, records, starts)


def camera_table(camera: Camera, preset: RasterPreset, device: torch.device) -> Tensor:
    """Return [TABLE] float64: the camera and the constants, for the kernels of ``kernels.projection``."""
    numbers = [
        *camera.viewmat[:3].double().flatten().tolist(),
        camera.fx,
        camera.fy,
        camera.cx,
        camera.cy,
        *ray_limits(camera, preset),
        preset.near,
        camera.width,
        camera.height,
        LOW_PASS,
        ALPHA_MIN,
        math.log(ALPHA_MIN),
        SLACK,
        math.sqrt(math.log2(math.e)),
        math.log2(math.e),
    ]
    assert len(numbers) == TABLE
    # A copy from pinned memory does not wait for running kernels.
    table = torch.tensor(numbers, dtype=torch.float64, pin_memory=device.type == "cuda")
    return table.to(device, non_blocking=True)
