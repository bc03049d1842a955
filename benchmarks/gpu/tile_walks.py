"""How far pixels go down the lists of their tiles, on the CPU in float64: our lists and gsplat's."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from scoup.raster.binning import Bins, grouped, tiles_in
from scoup.raster.presets import ALPHA_MIN, RASTER_PRESETS, RasterPreset
from scoup.raster.projection import ProjectedGaussians, tile_counts

GSPLAT_TILE, WARP = 16, 32  # a thread a pixel, row after row
GSPLAT = replace(RASTER_PRESETS["gsplat"], alpha_max=0.999)  # as up to 1.5
FURTHEST = 3.33  # standard deviations


@dataclass(frozen=True, eq=False)
class Walk:
    """Where the pixels [T, T] of a tile are along its list.

    Attributes:
        seen: [T, T] Gaussians that each pixel looks at until it stops, the one that stops it included; all if none
            does, 0 outside the image.
        painting: pairs of a pixel and a Gaussian that paints it.
        painting_steps: pairs of a warp of gsplat's (32 pixels, row after row) and a Gaussian that paints one of them.
    """

    seen: NDArray[np.int64]
    painting: int
    painting_steps: int


def rectangles(projection: ProjectedGaussians, width: int, height: int, tile: int = GSPLAT_TILE) -> Bins:
    """Gaussians of each tile as gsplat lists them: by the bounding rectangle of a radius in whole pixels.

    Source: gsplat 1.5.3, ProjectionEWA3DGSFused.cu and IntersectTile.cu.
    """
    across, down = tile_counts(width, height, tile)
    reach = torch.sqrt(2.0 * torch.log(projection.opacities / ALPHA_MIN).clamp(min=0)).clamp(max=FURTHEST)
    radii = torch.ceil(reach[:, None] * torch.sqrt(projection.covariances[:, [0, 2]]))
    limits = torch.tensor([across, down], dtype=torch.float64)
    centres = projection.means2d
    first = torch.minimum(torch.floor((centres - radii) / tile).clamp(min=0), limits)
    behind = torch.minimum(torch.ceil((centres + radii) / tile).clamp(min=0), limits)
    spans = torch.where((radii > 0).all(1, keepdim=True), behind - first, 0).clamp(min=0).long()
    ranks, row, column = tiles_in(first, spans)
    return grouped(ranks, row * across + column, tile, across, down)


def walk(
    projection: ProjectedGaussians,
    bins: Bins,
    tile: int,
    width: int,
    height: int,
    preset: RasterPreset,
    at_once: int = 1024,
) -> Walk:
    """Walk down the list of a tile until all its pixels have stopped.

    Args:
        projection: of the view.
        bins: its lists.
        tile: which one.
        width, height: of the image.
        preset: largest alpha, and when a pixel stops.
        at_once: Gaussians looked at together: no matter to what is found.
    """
    edge = bins.tile
    row, column = divmod(tile, bins.across)
    x, y = (np.arange(edge, dtype=np.float64) + place * edge + 0.5 for place in (column, row))
    inside = (x < width)[None, :] & (y < height)[:, None]
    start, end = bins.starts[tile : tile + 2].tolist()
    left = inside.astype(np.float64)  # transmittance, 0 where a pixel has stopped
    seen = np.zeros((edge, edge), np.int64)
    painting = painting_steps = 0
    for first in range(start, end, at_once):
        ranks = bins.ranks[first : min(first + at_once, end)]
        alpha = alphas(projection, ranks, x, y, preset)
        after = left * np.cumprod(1.0 - alpha, 0)
        goes_on = after > preset.stop if preset.stop_inclusive else after >= preset.stop
        # That which stops a pixel is looked at, too.
        before = np.concatenate([(left > 0)[None], goes_on[:-1]])
        seen += before.sum(0)
        paints = (alpha > 0) & goes_on
        painting += int(paints.sum())
        painting_steps += int(paints.reshape(len(ranks), -1, WARP).any(2).sum())
        left = np.where(goes_on[-1], after[-1], 0.0)
        if not left.any():
            break
    return Walk(seen, painting, painting_steps)


def alphas(
    projection: ProjectedGaussians,
    ranks: torch.Tensor,
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    preset: RasterPreset,
) -> NDArray[np.float64]:
    """[G, Y, X] of Gaussians at pixel centres, 0 where it is below 1/255."""
    xx, xy, yy = (part[:, None, None] for part in projection.covariances[ranks].numpy().T)
    determinant = projection.determinants[ranks].numpy()[:, None, None]
    opacity = projection.opacities[ranks].numpy()[:, None, None]
    centre_x, centre_y = (part[:, None, None] for part in projection.means2d[ranks].numpy().T)
    dx, dy = x[None, None, :] - centre_x, y[None, :, None] - centre_y
    exponent = -0.5 * (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / determinant
    alpha = np.minimum(opacity * np.exp(exponent), preset.alpha_max)
    return np.where(alpha >= ALPHA_MIN, alpha, 0.0)


def chunked(walks: list[Walk], chunk: int) -> int:
    """Lanes of programs that take so many Gaussians at a time."""
    return sum(math.ceil(int(own.seen.max()) / chunk) * chunk * own.seen.size for own in walks)


def warp_steps(walks: list[Walk]) -> tuple[int, int]:
    """Steps of gsplat's warps that paint, and that skip. A step in which pixels only stop counts as one that skips."""
    steps = sum(int(own.seen.reshape(-1, WARP).max(1).sum()) for own in walks)
    painting = sum(own.painting_steps for own in walks)
    return painting, steps - painting
