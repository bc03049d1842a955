"""The Gaussians that may contribute to each tile of the image."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from scoup.raster.presets import ALPHA_MIN
from scoup.raster.projection import ProjectedGaussians, tile_counts

# Bounds are relaxed by this many pixels, so that only the alpha test per pixel decides and the answer does not depend
# on the tile size.
SLACK = 1e-2


@dataclass(frozen=True, eq=False)
class Bins:
    """The Gaussians that reach each tile, nearest first; tile number = row * across + column."""

    tile: int  # edge length in pixels
    across: int  # tiles
    down: int
    ranks: Tensor  # [P] int64 rows of the projected Gaussians, tile after tile
    starts: Tensor  # [tiles + 1] int64, where each tile's rows begin in ``ranks``


def bin_to_tiles(projected: ProjectedGaussians, width: int, height: int, tile: int) -> Bins:
    """Expand every Gaussian to the tiles its ellipse touches and group by tile, keeping the depth order."""
    across, down = tile_counts(width, height, tile)
    extents = projected.extents() + SLACK
    limits = torch.tensor([across, down], dtype=torch.float64, device=extents.device)
    # Pixel centres lie at +0.5. Clamped as floats: an ellipse may be wider than any integer.
    first = torch.ceil(projected.means2d - extents - 0.5).div(tile).floor().clamp(min=0)
    last = torch.floor(projected.means2d + extents - 0.5).div(tile).floor()
    last = torch.minimum(last, limits - 1)
    spans = (last - first + 1).clamp(min=0).long()
    ranks, row, column = tiles_in(first, spans)
    touched = _ellipse_touches_tile(projected, ranks, column * tile, row * tile, tile)
    return grouped(ranks[touched], (row * across + column)[touched], tile, across, down)


def tiles_in(first: Tensor, spans: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Expand rectangles, of a first tile [M, 2] float64 (column, row) and a size [M, 2] int64, to their tiles.

    Returns [P] int64 each: the rectangle's number, row and column of the tile.
    """
    counts = spans[:, 0] * spans[:, 1]
    ranks = torch.repeat_interleave(counts)
    within = torch.arange(len(ranks), device=ranks.device) - (torch.cumsum(counts, 0) - counts)[ranks]
    row = torch.div(within, spans[ranks, 0], rounding_mode="floor")
    column = within - row * spans[ranks, 0] + first[ranks, 0].long()
    return ranks, row + first[ranks, 1].long(), column


def grouped(ranks: Tensor, tiles: Tensor, tile: int, across: int, down: int) -> Bins:
    """Group pairs in depth order by tile: a stable sort by tile alone keeps each tile's depth order."""
    order = torch.argsort(tiles.int(), stable=True)
    starts = torch.zeros(across * down + 1, dtype=torch.int64, device=ranks.device)
    starts[1:] = torch.cumsum(torch.bincount(tiles, minlength=across * down), 0)
    return Bins(tile, across, down, ranks[order], starts)


def _ellipse_touches_tile(
    projected: ProjectedGaussians, ranks: Tensor, left: Tensor, top: Tensor, tile: int
) -> Tensor:
    """Return [P] whether the ellipse alpha >= 1/255 reaches the rectangle of the tile's pixel centres.

    The distance of the ellipse's metric is convex, so its minimum over a rectangle that does not contain the centre
    lies on an edge facing the centre; along an edge it is a parabola.
    """
    xx, xy, yy = projected.covariances.unbind(1)
    radius2 = 2.0 * torch.log(projected.opacities / ALPHA_MIN)
    xx_yy_xy_det = torch.stack([xx, yy, xy, projected.determinants, radius2], 1)[ranks]
    var_x, var_y, covariance, determinant, reach = xx_yy_xy_det.unbind(1)
    centre = projected.means2d[ranks]
    x0, y0 = left + 0.5 - SLACK - centre[:, 0], top + 0.5 - SLACK - centre[:, 1]
    span = tile - 1 + 2 * SLACK
    x1, y1 = x0 + span, y0 + span
    # Offsets from the centre to the nearest vertical and horizontal edge; zero while the centre is between them.
    edge_x = x0.clamp(min=0) + x1.clamp(max=0)
    edge_y = y0.clamp(min=0) + y1.clamp(max=0)

    # Along x = edge_x the best y is covariance / var_x * edge_x, brought into the edge; likewise along y = edge_y.
    off_y = covariance / var_x * edge_x
    off_y = off_y - torch.minimum(torch.maximum(off_y, y0), y1)
    off_x = covariance / var_y * edge_y
    off_x = off_x - torch.minimum(torch.maximum(off_x, x0), x1)
    by_x = edge_x * edge_x / var_x + off_y * off_y * (var_x / determinant)
    by_y = edge_y * edge_y / var_y + off_x * off_x * (var_y / determinant)
    inside = (edge_x == 0) & (edge_y == 0)
    best = torch.where(edge_x == 0, by_y, torch.where(edge_y == 0, by_x, torch.minimum(by_x, by_y)))
    return inside | (best <= reach)
