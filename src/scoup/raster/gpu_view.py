"""A scene as one camera sees it, on a GPU: projected, binned to tiles and sorted by the kernels of ``kernels``."""

# A launch takes plain numbers as constants, and options beside the kernel's arguments.
# pyright: reportArgumentType=false, reportCallIssue=false

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import torch
import triton
from torch import Tensor

from scoup.cameras import Camera
from scoup.errors import InputError
from scoup.gaussians import Gaussians
from scoup.raster.binning import SLACK
from scoup.raster.kernels.projection import (
    GEOMETRY,
    TABLE,
    expand_kernel,
    project_kernel,
    sieve_kernel,
)
from scoup.raster.presets import ALPHA_MIN, LOW_PASS, RasterPreset
from scoup.raster.projection import ray_limits, tile_counts

Precision = Literal["fp16x3", "ieee", "tf32x3", "tf32"]

# Products may be added unrounded: which Triton lets them by default depends on its version.
FUSED = {"enable_fp_fusion": True}
TILE = 16  # edge of a tile in pixels
MOST_PAIRS = 2**31 - 1
_BLOCK = 128


@dataclass(frozen=True, eq=False)
class GpuView:
    """A scene as one camera sees it: projected, binned and sorted. Made by ``look``.

    Attributes:
        n_gaussians: N of the scene.
        width, height: image size in pixels.
        preset: the rasteriser constants used.
        records: [N, 4] float32 of each visible Gaussian, see ``kernels.blending.load_chunk``; not set elsewhere.
        pair_ids: [P] int32, for each tile the Gaussians that reach it, nearest first.
        corners: [P, 2] float32, each Gaussian's terms at the first pixel of the tile.
        starts: [tiles + 1] int64, where each tile begins in these.
        visible: of the Gaussians, with the way back from them to their pairs.
        precision: of matrix products. "fp16x3" splits float32 into two float16 and multiplies these on tensor cores,
            where numbers are known to fit, and is "tf32x3" elsewhere; "tf32x3" does the same with tf32; "ieee" is
            plain float32; "tf32" keeps 11 bits.
    """

    n_gaussians: int
    width: int
    height: int
    preset: RasterPreset
    records: Tensor
    pair_ids: Tensor
    corners: Tensor
    starts: Tensor
    visible: Visible
    precision: Precision = "fp16x3"

    backend = "triton"

    @property
    def device(self) -> torch.device:
        return self.records.device

    @property
    def across(self) -> int:
        """Tiles in a row."""
        return math.ceil(self.width / TILE)

    @property
    def n_tiles(self) -> int:
        return len(self.starts) - 1

    def products(self, wide: bool = False) -> Precision:
        """How this GPU multiplies; ``wide`` where numbers may be beyond what float16 can hold.

        AMD's matrix units know no products of split tf32: they multiply float32 as it is.
        """
        chosen = "tf32x3" if wide and self.precision == "fp16x3" else self.precision
        return "ieee" if torch.version.hip and chosen != "fp16x3" else chosen


@dataclass(frozen=True, eq=False)
class Visible:
    """The Gaussians a camera may see, nearest first, and their candidate pairs with tiles, Gaussian after Gaussian.

    Attributes:
        ids: [M] int64 rows of the scene.
        firsts: [M + 1] int64, where the candidates of each begin.
        tiles: [C] int16 or int32 tile of each candidate; the number of tiles where the ellipse misses it.
        places: [C] int32, where the candidate is in the lists of the tiles.
    """

    ids: Tensor
    firsts: Tensor
    tiles: Tensor
    places: Tensor


def look(
    gaussians: Gaussians, camera: Camera, preset: RasterPreset, precision: Precision = "fp16x3"
) -> GpuView:
    """See ``raster.look``; ``precision`` as in ``GpuView``.

    Raises:
        InputError: the view has more pairs of Gaussians and tiles than 31 bits can number.
    """
    device = gaussians.device
    with torch.cuda.device_of(gaussians.means):
        table = camera_table(camera, preset, device)
        scene = [
            part.contiguous()
            for part in (gaussians.means, gaussians.quats, gaussians.scales, gaussians.opacities)
        ]
        means, _, scales, opacities = scene
        count = len(gaussians)
        keep = torch.zeros(count, dtype=torch.int8, device=device)
        if count:
            grid = (triton.cdiv(count, _BLOCK),)
            sieve_kernel[grid](means, scales, opacities, table, keep, count, BLOCK=_BLOCK, **FUSED)
        ids = torch.nonzero(keep).squeeze(1)
        return _bin(gaussians, camera, preset, precision, scene, ids, table)


def _bin(
    gaussians: Gaussians,
    camera: Camera,
    preset: RasterPreset,
    precision: Precision,
    scene: list[Tensor],
    ids: Tensor,  # [M]
    table: Tensor,
) -> GpuView:
    device, n_visible = gaussians.device, len(ids)
    across, down = tile_counts(camera.width, camera.height, TILE)
    n_tiles = across * down
    records = torch.empty(len(gaussians), 4, device=device)
    depths = torch.empty(n_visible, dtype=torch.float64, device=device)
    geometry = torch.empty(n_visible, GEOMETRY.value, dtype=torch.float64, device=device)
    rects = torch.empty(n_visible, 3, dtype=torch.int32, device=device)
    counts = torch.zeros(n_visible, dtype=torch.int32, device=device)
    if n_visible:
        grid = (triton.cdiv(n_visible, _BLOCK),)
        project_kernel[grid](
            ids, *scene, table, depths, geometry, rects, counts, records, n_visible, across, down,
            TILE=TILE, BLOCK=_BLOCK, **FUSED,
        )  # fmt: skip
    # Equal depths stay in the order of the rows.
    order = torch.sort(depths, stable=True).indices
    firsts = torch.zeros(n_visible + 1, dtype=torch.int64, device=device)
    torch.cumsum(counts[order], 0, out=firsts[1:])
    n_pairs = int(firsts[-1])
    if n_pairs > MOST_PAIRS:
        raise InputError(
            f"a view of {camera.width} x {camera.height} with {n_pairs} pairs of Gaussians and tiles is too much for "
            "one pass; make the images smaller or prune the scene"
        )
    ranks = torch.repeat_interleave(firsts.diff(), output_size=n_pairs)
    # Radix sorts take as many passes as the keys have bytes.
    tile_type = torch.int16 if n_tiles < 2**15 else torch.int32
    tiles = torch.empty(n_pairs, dtype=tile_type, device=device)
    pair_ids = torch.empty(n_pairs, dtype=torch.int32, device=device)
    corners = torch.empty(n_pairs, 2, device=device)
    if n_pairs:
        grid = (triton.cdiv(n_pairs, _BLOCK),)
        expand_kernel[grid](
            ranks, order, firsts, ids, rects, geometry, table, tiles, pair_ids, corners, n_pairs, across, down,
            TILE=TILE, BLOCK=_BLOCK, **FUSED,
        )  # fmt: skip
    del ranks, geometry, rects
    # The candidates are in depth order, so a stable sort by tile alone keeps each tile's.
    in_order, by_tile = torch.sort(tiles, stable=True)
    starts = torch.searchsorted(in_order, torch.arange(n_tiles + 1, dtype=tile_type, device=device))
    places = torch.empty(n_pairs, dtype=torch.int32, device=device)
    places[by_tile] = torch.arange(n_pairs, dtype=torch.int32, device=device)
    return GpuView(
        len(gaussians),
        camera.width,
        camera.height,
        preset,
        records,
        pair_ids[by_tile],
        corners[by_tile],
        starts,
        Visible(ids[order], firsts, tiles, places),
        precision,
    )


def camera_table(camera: Camera, preset: RasterPreset, device: torch.device) -> Tensor:
    """[TABLE] float64: what the kernels of ``kernels.projection`` know of a camera and of the constants."""
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
    return torch.tensor(numbers, dtype=torch.float64).to(device)
