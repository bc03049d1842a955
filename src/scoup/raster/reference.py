"""The rasteriser in plain torch: the readable specification that every faster backend is tested against.

A tile's Gaussians are taken front to back in chunks. For one chunk the blending weights of G Gaussians at P
pixels are a matrix E [G, P]; rendering is E^T @ values, and the region sums are E @ one-hot(regions). Several
tiles are blended together so that each torch call has enough to do.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from scoup.raster.binning import Bins, bin_to_tiles
from scoup.raster.combinations import CombinedLabels, merge
from scoup.raster.decoding import cosines_and_norms
from scoup.raster.presets import ALPHA_MIN, RasterPreset
from scoup.raster.projection import ProjectedGaussians, project_gaussians
from scoup.scene import Camera, Gaussians, check_atoms, rows_of

PREPARES = False  # the order of the rows makes no difference to the speed
TILE = 16  # edge of a tile in pixels
TILES = 32  # tiles that go through together
CHUNK = 32  # Gaussians of each tile taken at a time

# torch's threshold keeps values strictly above the bound; alpha = 1/255 itself must stay.
_BELOW_ALPHA_MIN = float(torch.nextafter(torch.tensor(ALPHA_MIN), torch.tensor(0.0)))


@dataclass(frozen=True, eq=False)
class ReferenceProjection:
    """A scene as one camera sees it: projected, binned and sorted."""

    n_gaussians: int  # of the scene
    width: int  # pixels
    height: int
    preset: RasterPreset
    visible: ProjectedGaussians
    bins: Bins
    ellipses: Tensor  # [M, 4] float64 (ku, slope, kv, log opacity): see ``_alpha``

    backend = "reference"


def project(gaussians: Gaussians, camera: Camera, preset: RasterPreset) -> ReferenceProjection:
    """Project, bin and sort."""
    visible = project_gaussians(gaussians, camera, preset)
    _, xy, yy = visible.covariances.unbind(1)
    # exp(-q/2) with q = (dx - slope dy)^2 / var(x | y) + dy^2 / yy: two squares instead of the conic's three
    # terms, which cancel badly for needles.
    ellipses = torch.stack(
        [
            torch.sqrt(0.5 * yy / visible.determinants),
            xy / yy,
            torch.sqrt(0.5 / yy),
            torch.log(visible.opacities),
        ],
        1,
    )
    bins = bin_to_tiles(visible, camera.width, camera.height, TILE)
    return ReferenceProjection(len(gaussians), camera.width, camera.height, preset, visible, bins, ellipses)


def region_sums(projection: ReferenceProjection, combined: CombinedLabels) -> tuple[Tensor, Tensor, Tensor]:
    """See ``raster.region_sums``."""
    n_combinations = len(combined.table)
    entries: list[tuple[Tensor, Tensor, Tensor]] = []
    tiled = to_tiles(combined.map.long(), projection.bins, fill=-1)  # [tiles, P]
    for batch in _batches(projection):
        one_hot, number_of_column = _one_hot_columns(tiled[batch.tiles], n_combinations)
        for slots, ranks, weights in _blend(projection, batch):
            sums = torch.bmm(weights, one_hot[slots])  # [t, G, C]
            at = torch.nonzero(sums, as_tuple=True)
            entries.append(
                (projection.visible.ids[ranks[at[0], at[1]]], number_of_column[slots[at[0]], at[2]], sums[at])
            )
    if not entries:
        empty = torch.zeros(0, dtype=torch.int32, device=combined.map.device)
        return empty, empty, torch.zeros(0, device=combined.map.device)
    gaussian, number, weight = (torch.cat(parts) for parts in zip(*entries, strict=True))
    return merge(gaussian, number, weight, max(1, n_combinations))


def render_channels(projection: ReferenceProjection, values: Tensor) -> tuple[Tensor, Tensor]:
    """See ``raster.render_channels``."""
    channels = values.shape[1]
    tiles = _empty_tiles(projection, channels + 1, values.device)
    for tile, ids, weights in tile_weights(projection):
        tiles[tile, :, :channels] = weights.T @ values[ids]
        tiles[tile, :, channels] = weights.sum(0)
    image = _from_tiles(tiles, projection)
    return image[..., :channels], image[..., channels]


def render_codes(projection: ReferenceProjection, indices: Tensor, weights: Tensor, n_atoms: int) -> Tensor:
    """See ``raster.render_codes``."""
    check_atoms(indices, n_atoms)
    levels = indices.shape[1]
    tiles = _empty_tiles(projection, levels * n_atoms, weights.device)
    for tile, ids, blending in tile_weights(projection):
        tiles[tile] = blending.T @ _dense_codes(rows_of(indices, ids), weights[ids], n_atoms)
    image = _from_tiles(tiles, projection)
    return (
        image.reshape(projection.height, projection.width, levels, n_atoms).permute(2, 0, 1, 3).contiguous()
    )


def render_cosines_and_norms(
    projection: ReferenceProjection, indices: Tensor, weights: Tensor, codebook: Tensor, queries: Tensor
) -> tuple[Tensor, Tensor]:
    """See ``raster.render_cosines_and_norms``. No map of coefficients is kept."""
    levels, n_atoms, _ = codebook.shape
    check_atoms(indices, n_atoms)
    count = len(queries)
    scores, grams = codebook @ queries.T, codebook @ codebook.transpose(1, 2)
    tiles = _empty_tiles(projection, levels * (count + 1), weights.device)
    for tile, ids, blending in tile_weights(projection):
        painted = blending.T @ _dense_codes(rows_of(indices, ids), weights[ids], n_atoms)
        by_level = painted.view(-1, levels, n_atoms).transpose(0, 1)
        cosines, norms = cosines_and_norms(by_level, scores, grams)  # [S, P, Q] and [S, P]
        values = torch.cat([cosines, norms[..., None]], 2)
        tiles[tile] = values.transpose(0, 1).flatten(1)
    image = _from_tiles(tiles, projection).reshape(projection.height, projection.width, levels, count + 1)
    image = image.permute(2, 3, 0, 1)
    return image[:, :count].contiguous(), image[:, count].contiguous()


@dataclass(frozen=True, eq=False)
class _Batch:
    """Tiles that go through together: their numbers [T], and where their rows start and end in ``bins.ranks``."""

    tiles: Tensor
    starts: Tensor
    ends: Tensor


def _batches(projection: ReferenceProjection) -> Iterator[_Batch]:
    """Yield tiles that are not empty, the fullest first, so that tiles of a batch have about as many Gaussians."""
    starts = projection.bins.starts
    counts = starts[1:] - starts[:-1]
    order = torch.argsort(counts, descending=True, stable=True)
    order = order[: int((counts > 0).sum())]
    for first in range(0, len(order), TILES):
        tiles = order[first : first + TILES]
        yield _Batch(tiles, starts[tiles], starts[tiles + 1])


def tile_weights(projection: ReferenceProjection) -> Iterator[tuple[int, Tensor, Tensor]]:
    """Yield (tile, ids [G], weights [G, P]): the Gaussians that contribute to it and how much to each pixel."""
    for batch in _batches(projection):
        parts = []
        for slots, ranks, weights in _blend(projection, batch):
            painting = torch.nonzero(weights.amax(2), as_tuple=True)
            parts.append((slots[painting[0]], ranks[painting], weights[painting]))
        slots, ranks, weights = (torch.cat(items) for items in zip(*parts, strict=True))
        order = torch.argsort(slots, stable=True)  # chunks come front to back, so each tile stays so
        ids, weights = projection.visible.ids[ranks[order]], weights[order]
        counts = torch.bincount(slots, minlength=len(batch.tiles)).tolist()
        yield from zip(batch.tiles.tolist(), ids.split(counts), weights.split(counts), strict=True)


def _blend(projection: ReferenceProjection, batch: _Batch) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
    """Blending weights of a batch, chunk by chunk, front to back.

    Yields (slots [t], ranks [t, G], weights [t, G, P]): the batch rows still unfinished, the projected Gaussians
    taken, and e = alpha * transmittance of each at each pixel. Rows beyond a tile's last Gaussian weigh zero.
    """
    pixels = projection.bins.tile**2
    device = projection.ellipses.device
    slots = torch.arange(len(batch.tiles), device=device)
    start, end = batch.starts, batch.ends
    transmittance = torch.ones(len(slots), pixels, device=device)
    lane = torch.arange(CHUNK, device=device)
    last_row = max(0, len(projection.bins.ranks) - 1)
    while len(slots):
        rows = start[:, None] + lane
        ranks = projection.bins.ranks[rows.clamp(max=last_row)]
        alpha = _alpha(projection, batch.tiles[slots], ranks, rows < end[:, None])
        after = 1.0 - alpha
        after[:, 0] *= transmittance
        for row in range(1, after.shape[1]):
            torch.mul(after[:, row], after[:, row - 1], out=after[:, row])
        alpha[:, 0] *= transmittance
        alpha[:, 1:] *= after[:, :-1]
        # A pixel stops before the Gaussian that would take its transmittance below the bound. Transmittance only
        # falls, so that one and all behind it are the ones masked here.
        unstopped = (
            after > projection.preset.stop
            if projection.preset.stop_inclusive
            else after >= projection.preset.stop
        )
        yield slots, ranks, alpha.mul_(unstopped)

        transmittance = after[:, -1] * unstopped[:, -1]
        start = start + CHUNK
        going_on = (start < end) & (transmittance.amax(1) > 0)
        if not going_on.all():
            slots, start, end, transmittance = (item[going_on] for item in (slots, start, end, transmittance))


def _alpha(projection: ReferenceProjection, tiles: Tensor, ranks: Tensor, valid: Tensor) -> Tensor:
    """[T, G, P] float32 alpha of each Gaussian at each pixel of its tile, zero where under 1/255 or not valid.

    alpha = exp(log opacity - (kv dy)^2 - (ku (dx - slope dy))^2). Offsets are formed in float64 from the tile's
    corner, so that the float32 work below sees small numbers however far away the Gaussian's centre lies.
    """
    bins = projection.bins
    corner_x = (tiles % bins.across * bins.tile).double()[:, None] + 0.5
    corner_y = torch.div(tiles, bins.across, rounding_mode="floor").mul(bins.tile).double()[:, None] + 0.5
    ku, slope, kv, log_opacity = projection.ellipses[ranks].unbind(2)
    centre_x, centre_y = projection.visible.means2d[ranks].unbind(2)
    dx, dy = corner_x - centre_x, corner_y - centre_y
    log_opacity = torch.where(valid, log_opacity, -torch.inf)

    step = torch.arange(bins.tile, dtype=torch.float64, device=tiles.device)
    # ku (dx - slope dy) as a term along x plus a term along y, the share of the tile's first row going with x.
    along_x = (ku[..., None] * ((dx - slope * dy)[..., None] + step)).float()
    skew = ((ku * slope)[..., None] * step).float()
    peak = (log_opacity[..., None] - (kv[..., None] * (dy[..., None] + step)) ** 2).float()

    u = along_x[:, :, None, :] - skew[:, :, :, None]
    exponent = torch.addcmul(peak[..., None], u, u, value=-1.0)
    alpha = exponent.exp_().clamp_(max=projection.preset.alpha_max)
    torch.threshold_(alpha, _BELOW_ALPHA_MIN, 0.0)
    return alpha.flatten(2)


def _dense_codes(indices: Tensor, weights: Tensor, n_atoms: int) -> Tensor:
    """Return [G, S * L] of sparse codes [G, S, K]."""
    count, levels, _ = indices.shape
    offsets = torch.arange(levels, device=indices.device)[:, None] * n_atoms
    dense = torch.zeros(count, levels * n_atoms, device=weights.device)
    return dense.scatter_add_(1, (indices.long() + offsets).flatten(1), weights.float().flatten(1))


def _one_hot_columns(numbers: Tensor, n_numbers: int) -> tuple[Tensor, Tensor]:
    """Return one_hot [T, P, C] float32 of numbers [T, P] below ``n_numbers``, and the number of each column [T, C].

    A tile has a column for each distinct number >= 0; C is the largest count of these.
    """
    tiles, pixels = numbers.shape
    present = torch.zeros(tiles, n_numbers + 1, dtype=torch.bool, device=numbers.device)
    present.scatter_(1, torch.where(numbers >= 0, numbers, n_numbers), True)
    present[:, n_numbers] = False
    column = torch.cumsum(present, 1) - 1
    columns = int(column[:, -1].max()) + 1
    number_of_column = torch.zeros(tiles, columns, dtype=torch.int64, device=numbers.device)
    at = torch.nonzero(present, as_tuple=True)
    number_of_column[at[0], column[at]] = at[1]
    # Pixels without a region go to a column of their own, which is then cut off.
    column_of_pixel = torch.where(numbers >= 0, column.gather(1, numbers.clamp(min=0)), columns)
    one_hot = torch.zeros(tiles, pixels, columns + 1, device=numbers.device)
    one_hot.scatter_(2, column_of_pixel[:, :, None], 1.0)
    return one_hot[..., :columns].contiguous(), number_of_column


def _empty_tiles(projection: ReferenceProjection, channels: int, device: torch.device) -> Tensor:
    return torch.zeros(
        projection.bins.across * projection.bins.down, projection.bins.tile**2, channels, device=device
    )


def to_tiles(map_: Tensor, bins: Bins, fill: int) -> Tensor:
    """Rearrange [H, W] to [tiles, P]; pixels beyond the image get ``fill``."""
    height, width = map_.shape
    margin = (0, bins.across * bins.tile - width, 0, bins.down * bins.tile - height)
    padded = torch.nn.functional.pad(map_, margin, value=fill)
    blocks = padded.view(bins.down, bins.tile, bins.across, bins.tile)
    return blocks.transpose(1, 2).reshape(bins.across * bins.down, bins.tile**2)


def _from_tiles(tiles: Tensor, projection: ReferenceProjection) -> Tensor:
    """Rearrange [tiles, P, C] to [H, W, C]."""
    bins, channels = projection.bins, tiles.shape[2]
    blocks = tiles.view(bins.down, bins.across, bins.tile, bins.tile, channels).permute(0, 2, 1, 3, 4)
    image = blocks.reshape(bins.down * bins.tile, bins.across * bins.tile, channels)
    return image[: projection.height, : projection.width].contiguous()
